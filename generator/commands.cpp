#include "generator/commands.h"

#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

#include "generator/command_tools.h"
#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/contact_sheet.h"
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

GenerateOptions generate_options(const fs::path& out, ProgressBar& bar, std::atomic<bool>& stop) {
  GenerateOptions options;
  options.out = out;
  options.stop = &stop;
  options.progress = [&bar](const Progress& p) {
    if (p.views_total > 0) bar.update(p.views_done, p.views_total, p.stage);
  };
  return options;
}

// A folder that is gone again at the end.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (fs::temp_directory_path() / "moomill-preview-XXXXXX").string();
    if (!::mkdtemp(name.data())) run_error("no temporary folder can be made in {}", fs::temp_directory_path().string());
    path = name;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  fs::path path;
};

int preview_dataset(const fs::path& folder, const PreviewCommand& command) {
  ContactSheetOptions options;
  options.frame = command.frame;
  options.camera = command.camera;
  options.coat = command.coat;
  const Image8 sheet = command.modalities ? modality_sheet(folder, options) : contact_sheet(folder, options);
  const std::vector<std::uint8_t> png = encode_png8(sheet);
  write_file_atomically(command.out, png.data(), png.size());
  spdlog::info("{} is {} x {} pixels", command.out, sheet.width, sheet.height);
  return 0;
}

// One frame of the scene, small and with few samples, then the sheet of that.
int preview_scene(const PreviewCommand& command, std::atomic<bool>& stop) {
  constexpr int width = 320, samples = 16;
  SceneSpec scene = read_scene(command.source);
  Overrides o;
  o.first_frame = o.last_frame = command.frame.value_or(scene.frames.front());
  o.coats = {command.coat.value_or(scene.coat_indices.front())};
  if (command.modalities) o.cameras = {command.camera.value_or(cameras_of_frame(scene, *o.first_frame).front().id)};
  o.samples = std::min(samples, scene.render.samples);
  if (scene.cameras.width > width)
    o.resolution = {width, std::max(1, scene.cameras.height * width / scene.cameras.width)};
  apply_overrides(scene, o);
  const TemporaryFolder folder;
  {
    ProgressBar bar("views");
    generate(scene, generate_options(folder.path / "dataset", bar, stop));
  }
  return preview_dataset(folder.path / "dataset", command);
}

}  // namespace

int run_plan(const PlanCommand& command) {
  const PlanReport report = plan(scene_of(command.scene, command.options));
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

int run_preview(const PreviewCommand& command, std::atomic<bool>& stop) {
  require_extension("-o", command.out, ".png");
  const fs::path source = command.source;
  std::error_code ignored;
  if (fs::is_directory(source, ignored)) return preview_dataset(source, command);
  if (source.extension() != ".toml")
    input_error("{} is neither a dataset folder nor a scene file; name one of them", command.source);
  return preview_scene(command, stop);
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
