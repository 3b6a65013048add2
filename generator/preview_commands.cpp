// `moomill preview`: sheets for the human eye, of datasets, scenes and rigs.
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>

#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/contact_sheet.h"
#include "generator/progress_bar.h"
#include "scenes/generate.h"
#include "scenes/runner.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

int write_sheet(const Image8& sheet, const std::string& out) {
  const std::vector<std::uint8_t> png = encode_png8(sheet);
  write_file_atomically(out, png.data(), png.size());
  spdlog::info("{} is {} x {} pixels", out, sheet.width, sheet.height);
  return 0;
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
  return write_sheet(command.modalities ? modality_sheet(folder, options) : contact_sheet(folder, options), command.out);
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

// Small pictures of the scene's shape, with no more samples than they need.
void make_small(SceneSpec& scene, int width, int samples) {
  Overrides o;
  o.samples = std::min(samples, scene.render.samples);
  if (scene.cameras.width > width)
    o.resolution = {width, std::max(1, scene.cameras.height * width / scene.cameras.width)};
  apply_overrides(scene, o);
}

int chosen_camera(const SceneSpec& scene, const PreviewCommand& command) {
  const std::vector<int> ids = all_camera_ids(scene.cameras);
  const int camera = command.camera.value_or(ids.front());
  if (!std::binary_search(ids.begin(), ids.end(), camera))
    input_error("--camera: {} has no camera {}; its ids run from {} to {}", command.source, camera, ids.front(), ids.back());
  return camera;
}

const CameraRecord& find_camera(const Frame& frame, int id) {
  const auto found = std::find_if(frame.cameras.begin(), frame.cameras.end(), [&](const CameraRecord& c) { return c.id == id; });
  check(found != frame.cameras.end(), "the frame lacks a camera of its scene");
  return *found;
}

Image8 color_of(const View& view, int coat, float exposure = 1) {
  const Map* rgb = view.find(Modality::rgb, coat);
  check(rgb != nullptr, "the view has no colour");
  if (exposure == 1) return to_srgb8(rgb->f, view.background);
  ImageF dimmed = rgb->f;
  for (std::size_t i = 0; i < dimmed.data.size(); ++i)
    if (i % 4 != 3) dimmed.data[i] *= exposure;
  return to_srgb8(dimmed, view.background);
}

// Cuts all pictures to the same rectangle: what is not black in any of them, and a little around it.
void crop_together(std::vector<Image8>& pictures) {
  constexpr int margin = 6;
  int x0 = pictures.at(0).width, y0 = pictures[0].height, x1 = -1, y1 = -1;
  for (const Image8& p : pictures)
    for (int y = 0; y < p.height; ++y)
      for (int x = 0; x < p.width; ++x)
        if (p.at(x, y, 0) | p.at(x, y, 1) | p.at(x, y, 2))
          x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
  if (x1 < x0) return;
  x0 = std::max(0, x0 - margin), y0 = std::max(0, y0 - margin);
  x1 = std::min(pictures[0].width - 1, x1 + margin), y1 = std::min(pictures[0].height - 1, y1 + margin);
  for (Image8& p : pictures) {
    Image8 cut(x1 - x0 + 1, y1 - y0 + 1, 3);
    for (int y = 0; y < cut.height; ++y)
      for (int x = 0; x < cut.width; ++x)
        for (int c = 0; c < 3; ++c) cut.at(x, y, c) = p.at(x0 + x, y0 + y, c);
    p = std::move(cut);
  }
}

// Frames of a scene beside each other, from one camera: a walk as a strip.
int preview_strip(const PreviewCommand& command) {
  SceneSpec scene = read_scene(command.source);
  Overrides o;
  if (!command.frames.empty()) std::tie(o.first_frame, o.last_frame) = parse_range("--frames", command.frames);
  o.coats = {command.coat.value_or(scene.coat_indices.front())};
  o.cameras = {chosen_camera(scene, command)};
  o.modalities = {"rgb"};
  apply_overrides(scene, o);
  make_small(scene, 512, 16);
  const auto frames = static_cast<int>(scene.frames.size());
  if (*command.strip > frames)
    input_error("--strip {}: {} has {} such frames; ask for fewer, or widen --frames", *command.strip, command.source, frames);
  std::vector<int> chosen;  // spread evenly over what there is
  for (int i = 0; i < *command.strip; ++i) chosen.push_back(scene.frames[static_cast<std::size_t>(std::int64_t{i} * frames / *command.strip)]);
  const Mill mill(scene);
  std::vector<Image8> cells;
  std::vector<std::string> labels;
  ProgressBar bar("views");
  for (const int f : chosen) {
    const Frame frame = mill.prepare(f);
    cells.push_back(color_of(mill.trace(frame, find_camera(frame, o.cameras[0])), o.coats[0]));
    labels.push_back(fmt::format("frame {}", f));
    bar.update(cells.size(), chosen.size());
  }
  crop_together(cells);
  return write_sheet(picture_grid(cells, labels, 6, fmt::format("{}  camera {}", scene.animals[0].species, o.cameras[0])), command.out);
}

// One view in every coat of the scene.
int preview_coats(const PreviewCommand& command) {
  SceneSpec scene = read_scene(command.source);
  Overrides o;
  o.first_frame = o.last_frame = command.frame.value_or(scene.frames.front());
  o.cameras = {chosen_camera(scene, command)};
  o.modalities = {"rgb"};
  apply_overrides(scene, o);
  const bool many = scene.coat_indices.size() > 16;
  make_small(scene, many ? 400 : 720, 32);
  scene.render.coat_resolution = std::min(scene.render.coat_resolution, many ? 512 : 1024);
  const Mill mill(scene);
  const Manifest manifest = mill.manifest();
  const Frame frame = mill.prepare(*o.first_frame);
  std::vector<Image8> cells;
  std::vector<std::string> labels;
  ProgressBar bar("coats");
  for (int b = 0; b < mill.batches(); ++b) {
    const auto dressed = mill.dress(frame, b);
    const View view = mill.trace_coats(frame, find_camera(frame, o.cameras[0]), *dressed);
    for (const int coat : dressed->coats) {
      cells.push_back(color_of(view, coat));
      labels.push_back(fmt::format("{} {}", coat, coat < static_cast<int>(manifest.coats.size()) ? manifest.coats[coat] : ""));
    }
    bar.update(cells.size(), scene.coat_indices.size());
  }
  crop_together(cells);
  return write_sheet(picture_grid(cells, labels, many ? 8 : 4, fmt::format("{}  {} coats", scene.animals[0].species, cells.size())), command.out);
}

// Every joint has its colour; a point has the mean of those it moves with. Darker where the surface turns away, so
// that the shape shows.
Image8 show_weights(const View& view, const CameraRecord& camera, const Rig& rig) {
  const Map &ids = *view.find(Modality::triangle), &normals = *view.find(Modality::normal);
  const vec3 forward(camera.world_to_camera[8], camera.world_to_camera[9], camera.world_to_camera[10]);
  Image8 out(view.width, view.height, 3);
  for (std::size_t i = 0; i < ids.u.data.size(); ++i) {
    if (ids.u.data[i] == 0 || ids.u.data[i] > rig.surface.triangles.size()) continue;
    const uvec3& t = rig.surface.triangles[ids.u.data[i] - 1];
    const float b1 = ids.f.data[2 * i], b2 = ids.f.data[2 * i + 1], share[3] = {1 - b1 - b2, b1, b2};
    vec3 color(0);
    for (int k = 0; k < 3; ++k)
      for (std::uint32_t j = rig.influence_begin[t[k]]; j < rig.influence_begin[t[k] + 1]; ++j) {
        const auto c = color_of_id(rig.influences[j].bone + 1);
        color += share[k] * rig.influences[j].weight * vec3(c[0], c[1], c[2]);
      }
    const vec3 n(normals.f.data[3 * i], normals.f.data[3 * i + 1], normals.f.data[3 * i + 2]);
    color *= 0.35f + 0.65f * std::abs(glm::dot(n, forward));
    for (int c = 0; c < 3; ++c) out.data[3 * i + c] = static_cast<std::uint8_t>(std::clamp(color[c], 0.0f, 255.0f) + 0.5f);
  }
  return out;
}

Image8 show_nnopcs(const View& view) {
  const Map& map = *view.find(Modality::nnopcs);
  Image8 out(view.width, view.height, 3);
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] = static_cast<std::uint8_t>(255 * std::clamp(map.f.data[i], 0.0f, 1.0f) + 0.5f);
  return out;
}

Image8 show_parts(const View& view) {
  const Map& map = *view.find(Modality::part);
  Image8 out(view.width, view.height, 3);
  for (std::size_t i = 0; i < map.u.data.size(); ++i) {
    const auto color = color_of_id(map.u.data[i]);
    for (int c = 0; c < 3; ++c) out.data[3 * i + c] = color[c];
  }
  return out;
}

// A rig in its neutral pose and its own material: 24 views with keypoints, then from the middle ring what its joints
// move (weights), its neutral coordinates, and its body parts.
int preview_rig(const PreviewCommand& command) {
  const fs::path file = fs::absolute(find_species(command.source, {}));
  const TemporaryFolder folder;
  std::string name;  // as a TOML text
  for (const char c : file.string()) name += c == '"' || c == '\\' ? std::string("\\") + c : std::string(1, c);
  std::ofstream(folder.path / "rig.toml")
      << "modalities = [\"rgb\", \"nnopcs\", \"normal\", \"part\", \"triangle\", \"keypoints\"]\n[[animals]]\nspecies = \"" << name
      << "\"\ncoats = [\"own\"]\n[cameras]\nresolution = [512, 384]\n[render]\nsamples = 16\n";
  SceneSpec scene = read_scene(folder.path / "rig.toml");
  scene.animals[0].poses = {PoseFile{"the neutral pose", std::make_shared<const Json>(Json::array({Json::object()}))}};
  scene.frames = {scene.first_frame};
  const Mill mill(scene);
  const Manifest manifest = mill.manifest();
  const Species& species = mill.species(0);
  const Frame frame = mill.prepare(scene.first_frame);
  constexpr int columns = 8;
  const std::size_t views = frame.cameras.size(), middle = views >= 2 * columns ? columns : 0;
  std::vector<Image8> cells;
  std::vector<std::string> labels;
  std::vector<Image8> weights, nnopcs, parts;
  ProgressBar bar("views");
  for (std::size_t i = 0; i < views; ++i) {
    const View view = mill.trace(frame, frame.cameras[i]);
    cells.push_back(color_of(view, 0, 0.6f));  // clay is white, and must not lose its shape in the light
    draw_keypoints(cells.back(), manifest, view, 0, 1);
    labels.push_back(fmt::format("camera {}", view.camera));
    if (i >= middle && i < middle + columns) {
      weights.push_back(show_weights(view, frame.cameras[i], species.rig));
      nnopcs.push_back(show_nnopcs(view));
      parts.push_back(show_parts(view));
    }
    bar.update(i + 1, views);
  }
  const auto row = [&](const std::vector<Image8>& pictures, const char* what) {
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      cells.push_back(pictures[i]);
      labels.push_back(fmt::format("{} {}", what, frame.cameras[middle + i].id));
    }
  };
  row(weights, "weights");
  row(nnopcs, "nnopcs");
  row(parts, "parts");
  crop_together(cells);
  return write_sheet(picture_grid(cells, labels, columns, fmt::format("{}  {} triangles  {} joints  {} keypoints", species.name, species.rig.surface.triangles.size(), species.rig.bones.size(), species.keypoints.size())), command.out);
}

}  // namespace

int run_preview(const PreviewCommand& command, std::atomic<bool>& stop) {
  require_extension("-o", command.out, ".png");
  const fs::path source = command.source;
  std::error_code ignored;
  const bool dataset = fs::is_directory(source, ignored), scene = !dataset && source.extension() == ".toml" && fs::is_regular_file(source, ignored) && is_scene_file(source);
  if ((command.strip || command.coats) && !scene)
    input_error("--{} needs a scene file, and {} is none; name one", command.strip ? "strip" : "coats", command.source);
  if (dataset) return preview_dataset(source, command);
  if (command.strip) return preview_strip(command);
  if (command.coats) return preview_coats(command);
  if (scene) return preview_scene(command, stop);
  return preview_rig(command);
}

}  // namespace moomill
