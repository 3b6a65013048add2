#pragma once
// What leaving something out of a scene saves: one modality, one light, one coat less.
#include <atomic>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "scenes/scene.h"
#include "validate/studies/study.h"

namespace moomill {

// A scene without one of its parts, and the stages whose whole time is that part's (StageTimer names; one that ends in
// '*' stands for all that begin so).
struct Variant {
  std::string part;  // "modality depth", "light suns[0]", "coat 11"
  SceneSpec scene;
  std::vector<std::string> stages;
};
// Every modality, light and coat that can be left out, as long as something remains to be made.
std::vector<Variant> variants_of(const SceneSpec& scene);

// One run of `generate` in a process of its own, on one thread.
struct Run {
  double seconds = 0;         // of processors: everything but the loading of species, which no part changes
  double peak_megabytes = 0;  // 1e6 bytes, resident
  std::map<std::string, double> stages;
};
Run run_alone(const SceneSpec& scene, const std::filesystem::path& folder);  // RunError where the run fails

struct LeaveOut {
  Variant variant;
  std::vector<Run> with, without;  // pairs: one after the other
};
struct LeaveOutOptions {
  int repetitions = 5;
  std::vector<std::string> parts;  // of those of variants_of(); empty: all
  std::filesystem::path folder;  // where the datasets are made, and deleted again
  std::function<void(std::size_t, std::size_t, const std::string&)> progress;
  const std::atomic<bool>* stop = nullptr;
};
std::vector<LeaveOut> measure_leave_out(const SceneSpec& scene, const LeaveOutOptions& options);

// Per part: what its stages report, what leaving it out saved (median of the pairs), their ratio: at least 0.9, held where there are at
// least five pairs and they know the saving to a tenth of what the stages take.
StudyResult leave_out_study(const std::string& title, const std::vector<LeaveOut>& measured);

}  // namespace moomill
