#pragma once
// The long-running commands: a whole dataset, one view, and the plan of what would be done.
#include <atomic>
#include <filesystem>
#include <functional>
#include <string>

#include "scenes/scene.h"

namespace moomill {

class Mill;

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

// What a run of generate() on all cores would take: a few views of frames and cameras spread over the scene are made and written to a
// temporary folder, and what they take is carried over. Start and baking are measured once, cost per frame, picture and sample
// apart. Seconds are of one core where not said otherwise.
struct ProbeReport {
  struct Cost {
    double processor = 0, elapsed = 0;  // elapsed: where this program has the machine for itself
  };
  Cost start;               // loading, and the rig's file
  Cost baking;              // of all coats
  double frame = 0;         // pose, skin, hierarchy, light held on the surface
  double labels = 0;        // of a picture (frame and camera), all but rgb, with encoding
  double light = 0;         // of a picture in all coats, at the scene's samples or target error
  double encoding = 0;      // of rgb, of a picture in all coats
  std::size_t views = 0;    // measured: frames times cameras, each in one batch of coats
  int samples = 0;          // per pixel in them: fewer than the scene's where those take too long
  double wanted_samples = 0;  // per pixel, in the mean, that a target error comes to, its pilot left out; without one, the scene's
  double took = 0;          // the probe, after loading
  double processor_seconds = 0, seconds = 0;  // of the whole run: of all cores together, and elapsed
};
// Goes on to new views until about `seconds` of processor time are spent after loading. InputError as generate().
ProbeReport probe(const SceneSpec& scene, double seconds);

// Stages that run, stages left out and why, images, disk, time: from a probe, or by typical figures, and nothing is loaded.
PlanReport plan(const SceneSpec& scene, const ProbeReport* probed = nullptr);

// InputError where a pose that the scene's frames need cannot be made: a clip or a joint that does not exist, too few poses.
void require_poses(const SceneSpec& scene, const Mill& mill);

// Makes or continues the dataset. A frame is prepared while the one before is traced and encoded; at most two are in
// flight, and one view per thread, so memory does not grow with the dataset.
void generate(const SceneSpec& scene, const GenerateOptions& options);

// One view, every modality of the scene as a named layer of an EXR.
void render_view(const SceneSpec& scene, int frame, int camera, int coat, const std::filesystem::path& exr);

}  // namespace moomill
