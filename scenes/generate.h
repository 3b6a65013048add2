#pragma once
// The long-running commands: a whole dataset, one view, and the plan of what would be done.
#include <atomic>
#include <filesystem>
#include <functional>
#include <string>

#include "scenes/scene.h"

namespace moomill {

struct Progress {
  std::size_t views_done = 0, views_total = 0;  // of this run
  double seconds = 0;
  std::string stage;
};

struct GenerateOptions {
  std::filesystem::path out;
  int shard = 0, shards = 1;  // this run makes every shards-th frame, from the shard-th on
  int threads = 0;            // 0: all cores
  std::function<void(const Progress&)> progress;  // may be called from any thread, one at a time
  std::atomic<bool>* stop = nullptr;              // set: finish the frames in flight and throw RunError
};

struct PlanReport {
  std::string text;  // for people
  Json json;
};

// Stages that run, stages left out and why, images, disk, time.
PlanReport plan(const SceneSpec& scene);

// Makes or continues the dataset. A frame is prepared while the one before is traced and encoded; at most two are in
// flight, and one view per thread, so memory does not grow with the dataset.
void generate(const SceneSpec& scene, const GenerateOptions& options);

// One view, every modality of the scene as a named layer of an EXR.
void render_view(const SceneSpec& scene, int frame, int camera, int coat, const std::filesystem::path& exr);

}  // namespace moomill
