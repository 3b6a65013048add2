#include "generator/commands.h"

#include <spdlog/spdlog.h>
#include <algorithm>
#include <cstdio>

#include "generator/command_tools.h"
#include "generator/core/error.h"
#include "generator/progress_bar.h"
#include "scenes/generate.h"
#include "validate/checks.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

SceneSpec scene_of(const std::string& file, const SceneOptions& options) {
  SceneSpec scene = read_scene(file);
  apply_overrides(scene, parse_overrides(options));
  return scene;
}

}  // namespace

GenerateOptions generate_options(const fs::path& out, ProgressBar& bar, std::atomic<bool>& stop) {
  GenerateOptions options;
  options.out = out;
  options.stop = &stop;
  options.progress = [&bar](const Progress& p) {
    if (p.views_total > 0) bar.update(p.views_done, p.views_total, p.stage);
  };
  return options;
}

int run_plan(const PlanCommand& command) {
  const SceneSpec scene = scene_of(command.scene, command.options);
  std::optional<ProbeReport> probed;
  if (command.probe_seconds > 0) probed = probe(scene, command.probe_seconds);
  const PlanReport report = plan(scene, probed ? &*probed : nullptr);
  print(command.json ? report.json.dump(2) + "\n" : report.text);
  return 0;
}

int run_generate(const GenerateCommand& command, std::atomic<bool>& stop) {
  const SceneSpec scene = scene_of(command.scene, command.options);
  {
    ProgressBar bar("views");
    GenerateOptions options = generate_options(command.out, bar, stop);
    if (!command.shard.empty()) std::tie(options.shard, options.shards) = parse_shard(command.shard);
    options.threads = command.threads;
    generate(scene, options);
  }
  print(fmt::format("{} is complete\n", command.out));
  return 0;
}

int run_render(const RenderCommand& command) {
  require_extension("-o", command.out, ".exr");
  const SceneSpec scene = scene_of(command.scene, command.options);
  if (!std::binary_search(scene.frames.begin(), scene.frames.end(), command.frame))
    input_error("--frame: {} has no frame {}; its frames run from {} to {}", command.scene, command.frame,
                scene.frames.front(), scene.frames.back());
  const std::vector<int> ids = all_camera_ids(scene.cameras);
  if (!std::binary_search(ids.begin(), ids.end(), command.camera))
    input_error("--camera: {} has no camera {}; its ids run from {} to {}", command.scene, command.camera, ids.front(),
                ids.back());
  const int coats = static_cast<int>(scene.animals[0].coats.size());
  if (command.coat < 0 || command.coat >= coats)
    input_error("--coat: {} has no coat {}; its coats are 0 to {}", command.scene, command.coat, coats - 1);
  render_view(scene, command.frame, command.camera, command.coat, command.out);
  spdlog::info("{} holds frame {} of camera {} in coat {}", command.out, command.frame, command.camera, command.coat);
  return 0;
}

int run_merge(const MergeCommand& command) {
  merge_datasets({command.shards.begin(), command.shards.end()}, command.out, command.allow_missing);
  spdlog::info("{} joins {} shards", command.out, command.shards.size());
  return 0;
}

int run_validate(const std::string& folder) {
  std::vector<CheckResult> results;
  {
    ProgressBar bar("frames");
    results = validate_dataset(folder, [&](std::size_t done, std::size_t total) { bar.update(done, total); });
  }
  std::uint64_t failures = 0;
  std::size_t failed = 0, skipped = 0;
  for (const CheckResult& r : results) {
    const bool ok = r.failure_count == 0;
    if (ok && r.tested == 0) {  // never called a success: there was nothing to hold against anything
      ++skipped;
      print(fmt::format("skipped {}: {}\n", r.name, r.note.empty() ? "nothing to compare" : r.note));
      continue;
    }
    failed += !ok;
    failures += r.failure_count;
    const std::string worst = r.unit.empty() ? "" : fmt::format(", worst {:.3g} {}", r.worst, r.unit);
    print(fmt::format("{:<7} {}: {} compared{}\n", ok ? "ok" : "FAILED", r.name, r.tested, worst));
    for (const std::string& f : r.failures) print(fmt::format("        {}\n", f));
    if (r.failure_count > r.failures.size())
      print(fmt::format("        and {} more\n", r.failure_count - r.failures.size()));
  }
  if (failures == 0) {
    print(skipped == 0 ? fmt::format("{}: all {} checks hold\n", folder, results.size())
                       : fmt::format("{}: {} checks hold, {} had nothing to compare\n", folder, results.size() - skipped, skipped));
    return 0;
  }
  print(fmt::format("{}: {} of {} checks fail, {} failures in all\n", folder, failed, results.size(), failures));
  return 1;
}

}  // namespace moomill
