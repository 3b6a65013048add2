#pragma once
// What each command of `moomill` does, once its options are read. They return the exit status (0 or 1) or throw:
// InputError for bad input, RunError for failures while running. Results go to stdout, all else to stderr.
#include <atomic>
#include <filesystem>
#include <string>
#include <vector>

#include "generator/arguments.h"

namespace moomill {

struct PlanCommand {
  std::string scene;
  SceneOptions options;
  bool json = false;
  double probe_seconds = 5;
};
int run_plan(const PlanCommand& command);

struct GenerateCommand {
  std::string scene, out, shard, layout = "nepumoo";
  SceneOptions options;
  int threads = 0;
};
int run_generate(const GenerateCommand& command, std::atomic<bool>& stop);

struct RenderCommand {
  std::string scene, out;
  SceneOptions options;
  int frame = 0, camera = 0, coat = 0;
};
int run_render(const RenderCommand& command);

struct MergeCommand {
  std::vector<std::string> shards;
  std::string out;
  bool allow_missing = false;
};
int run_merge(const MergeCommand& command);

struct PreviewCommand {
  std::string source, out;  // a dataset folder, a scene file, a species or a rig file; a .png
  std::optional<int> frame, camera, coat;
  bool modalities = false;  // all modalities of one view instead of all views of a frame
  std::optional<int> strip;  // so many frames of a scene from one camera
  std::string frames;        // of the strip
  bool coats = false;        // one view of a scene in all its coats
};
int run_preview(const PreviewCommand& command, std::atomic<bool>& stop);

int run_validate(const std::string& folder);

struct StudyResult;
// Prints the table and what holds of the bounds; writes summary.json and table.md into `folder` unless it is empty.
// Returns 1 when a figure misses its bound.
int finish_study(const StudyResult& result, const std::string& folder);

struct StressCommand {
  std::string out, group;  // group: only these cases; empty: all
  std::uint64_t rays = 10'000'000;
  bool enforce = false;    // exit status 1 where a case is out of bounds
};
int run_stress_study(const StressCommand& command, const std::atomic<bool>& stop);

struct CompareCommand {
  std::string rig, reference, out;
};
int run_rig_compare(const CompareCommand& command);

struct ConvergeCommand {
  std::string scene, out, against;
  SceneOptions options;  // what is empty is chosen small: one frame, three cameras, two coats, 160 pixels wide
  std::string target_errors;  // "0.1,0.05": measured instead of sample counts
  int min_samples = 1, max_samples = 1024, repetitions = 3, reference_samples = 0, threads = 0, at_samples = 64;
  double slope_at_most = -0.97;
  bool enforce = false;  // exit status 1 where a figure misses its bound
};
int run_converge(const ConvergeCommand& command, std::atomic<bool>& stop);

struct LeaveOutCommand {
  std::string scene, out;
  SceneOptions options;  // without frames: the first
  std::string parts;     // "modality depth,coat 11"; empty: all
  int repetitions = 5;
  bool enforce = false;
};
int run_leave_out(const LeaveOutCommand& command, std::atomic<bool>& stop);

struct CrosscheckCommand {
  std::string scene, out, blender = "blender", timing;
  SceneOptions options;
  std::optional<int> frame;
  int label_scale = 3, threads = 0, reference = 0;
  bool enforce = false;  // exit status 1 where a figure misses its bound
};
int run_crosscheck(const CrosscheckCommand& command, const std::atomic<bool>& stop);

struct CoatBakeCommand {
  std::string coat, rig, out;
  std::string breed;  // instead of a coat: individuals of this breed, into the folder `out`
  int count = 12, first = 0;
  std::uint64_t seed = 0;
  int resolution = 2048;
};
struct IndividualsCommand {
  std::string species, breed, out;
  int count = 10000;
  std::uint64_t seed = 0;
};
int run_coat_individuals(const IndividualsCommand& command);

int run_coat_list(const std::string& species);
int run_coat_bake(const CoatBakeCommand& command);
int run_coat_compare(const std::string& species, const std::string& folder);

int run_rig_info(const std::string& rig);
int run_rig_check(const std::string& rig);
int run_rig_build(const std::string& spec, const std::string& out);
int run_rig_bind(const std::string& mesh, const std::string& keypoints, const std::string& out);
int run_rig_motion(const std::string& source, int samples, const std::string& folder);
int run_rig_deform(const std::string& scene, const SceneOptions& options, const std::string& folder);

}  // namespace moomill
