#pragma once
// Error against run time and samples, and the time two renderers need for the same error.
//
// The measurements are one CSV file, convergence.csv, for every renderer alike. Its header is convergence_header, and its
// rows are one picture each:
//   renderer       a name without a comma: moomill, cycles, ...
//   frame, camera  as numbered in the scene
//   coat           index; pictures of several coats are compared by adding their times and averaging their errors
//   spp            samples per pixel
//   seconds        elapsed, of this picture; where coats are rendered together, each has an equal share of their time
//   core_seconds   of processors, over all threads, shared alike
//   mse, relative_mse, ciede2000   as in error_measures.h, inside the silhouette, against the same renderer's reference
// Rows that agree in renderer, frame, camera, coat and spp are repetitions with independent samples, in their order.
#include <atomic>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "scenes/scene.h"
#include "validate/studies/error_measures.h"
#include "validate/studies/study.h"

namespace moomill {

inline constexpr const char* convergence_header = "renderer,frame,camera,coat,spp,seconds,core_seconds,mse,relative_mse,ciede2000";
inline constexpr const char* convergence_file = "convergence.csv";

struct ConvergenceRow {
  std::string renderer = "moomill";
  int frame = 0, camera = 0, coat = 0, samples = 0;
  double seconds = 0, core_seconds = 0;
  PictureError error;
};
std::string convergence_csv(const std::vector<ConvergenceRow>& rows);
// A file, or convergence.csv of a folder. InputError names the line that is not as above.
std::vector<ConvergenceRow> read_convergence(const std::filesystem::path& file_or_folder);

struct ConvergeOptions {
  int min_samples = 1;         // measured: so many, twice, four times, ...
  int max_samples = 1024;      // ... up to it
  std::vector<double> target_errors;  // measured instead, if any; `samples` of a row is then their mean number, rounded
  int repetitions = 3;         // of every sample count, each with samples of its own
  int reference_samples = 0;   // 0: 16 times max_samples
  int cameras_per_frame = 24;  // among which the preparation of a frame is shared
  int threads = 0;             // 0: one per core
  std::function<void(std::size_t, std::size_t, const std::string&)> progress;  // samples done, of all; what is being done
  const std::atomic<bool>* stop = nullptr;                                      // set: RunError at the next picture
};

struct ReferenceError {
  int frame = 0, camera = 0, coat = 0, samples = 0;
  double mse = 0;  // of the reference itself
};

struct Convergence {
  std::vector<ConvergenceRow> rows;
  std::vector<ReferenceError> references;
};
// Of the scene's frames, cameras and coats as chosen, each against a reference of its own.
Convergence measure_convergence(const SceneSpec& scene, const ConvergeOptions& options);

// How many times longer `other` takes than `own` for the error that `other` has at `samples`, over all frames and
// cameras measured in both, and all pairs of their repetitions; of the coats measured in both, together.
struct SpeedUp {
  std::vector<double> ratios;
  int outside = 0;  // pairs in which our curve does not reach that error between two of its points
};
enum class Measure { mse, relative_mse, ciede2000 };
SpeedUp speed_up(const std::vector<ConvergenceRow>& own, const std::vector<ConvergenceRow>& other, int samples, Measure measure,
                 bool core_seconds);

struct Against {
  std::vector<ConvergenceRow> rows;
  int samples = 64;  // of the other renderer: the error to be reached
};
// InputError where the other run has no picture in common with what is to be measured, or none at its sample count.
void require_common_pictures(const SceneSpec& scene, const Against& against);
// Table and figures; `title` names the scene. The slope wants three sample counts; with fewer it is told and not held.
StudyResult convergence_study(const std::string& title, const Convergence& measured, double slope_at_most,
                              const std::optional<Against>& against);
// File names and their text: error against samples, seconds and core seconds, as SVG.
std::vector<std::pair<std::string, std::string>> convergence_plots(const Convergence& measured, const std::optional<Against>& against);

}  // namespace moomill
