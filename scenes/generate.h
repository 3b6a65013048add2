#pragma once
// From a scene file to a dataset on disk, to one view, or to the plan of what would be done.
#include <atomic>
#include <filesystem>
#include <functional>
#include <string>

#include "scenes/scene.h"

namespace moomill {

struct Progress {
  std::size_t views_done = 0, views_total = 0;
  double seconds = 0;  // since the start
  std::string stage;
};

struct GenerateOptions {
  std::filesystem::path out;
  int shard = 0, shards = 1;  // shard i of n
  int threads = 0;            // 0: all cores this process may use
  std::function<void(const Progress&)> progress;
  std::atomic<bool>* stop = nullptr;  // when it becomes true, frames in flight are finished and no more begun
};

// Makes the dataset, or what is missing of it. Returns early, without error, when `stop` was set.
void generate(const SceneSpec& scene, const GenerateOptions& options);

// One view as a multi-layer EXR, every modality of the scene a named layer.
void render_view(const SceneSpec& scene, int frame, int camera, int coat, const std::filesystem::path& exr);

// What generate() would do: stages that run, stages left out and why, images, disk and time. Reads no rig and traces
// nothing.
struct PlanReport {
  std::string text;  // for people, ends with a newline
  Json json;         // the same for programs
};
PlanReport plan(const SceneSpec& scene);

}  // namespace moomill
