// What the command line changes of a scene.
#include <set>

#include "generator/core/error.h"
#include "scenes/scene.h"
#include "generator/core/words.h"

namespace moomill {
namespace {

std::string list_text(const std::vector<int>& values) {
  constexpr std::size_t most = 30;
  std::string out;
  for (std::size_t i = 0; i < values.size() && i < most; ++i) out += (i ? ", " : "") + std::to_string(values[i]);
  if (values.size() > most) out += fmt::format(", ... {}", values.back());
  return out;
}

// The wanted ones, ascending and once each; InputError names the first that is not there.
std::vector<int> choose(const std::vector<int>& wanted, const std::vector<int>& there, const char* option) {
  const std::set<int> known(there.begin(), there.end());
  for (const int w : wanted)
    if (!known.count(w)) input_error("{}: there is no {}; the scene has {}", option, w, list_text(there));
  const std::set<int> sorted(wanted.begin(), wanted.end());
  return {sorted.begin(), sorted.end()};
}

void override_frames(SceneSpec& scene, const Overrides& o) {
  const int first = o.first_frame.value_or(std::numeric_limits<int>::min());
  const int last = o.last_frame.value_or(std::numeric_limits<int>::max());
  if (first > last) input_error("--frames: the range {}:{} runs backwards; write the smaller first", first, last);
  std::vector<int> kept;
  for (const int f : scene.frames)
    if (f >= first && f <= last) kept.push_back(f);
  if (kept.empty())
    input_error("--frames: the range holds none of the scene's frames, which run from {} to {}", scene.frames.front(),
                scene.frames.back());
  scene.frames = std::move(kept);
}

}  // namespace

ModalitySet modalities_from_names(const std::vector<std::string>& names) {
  std::vector<std::string> known;
  for (const ModalityRow& r : modality_table()) known.emplace_back(r.name);
  ModalitySet set;
  for (const std::string& name : names) {
    if (name == "all") {
      for (const ModalityRow& r : modality_table()) set.add(r.id);
      continue;
    }
    const std::optional<Modality> m = modality_from_name(name);
    if (!m) {
      const std::string near = nearest_word(name, known);
      std::string all;
      for (const std::string& k : known) all += (all.empty() ? "" : ", ") + k;
      input_error("there is no modality '{}'{}; the modalities are {}", name,
                  near.empty() ? "" : fmt::format(" (did you mean '{}'?)", near), all);
    }
    set.add(*m);
  }
  return set;
}

std::vector<int> all_camera_ids(const CameraSpec& cameras) {
  std::set<int> ids;
  if (cameras.rings)
    for (int i = 0; i < cameras.rings->count * static_cast<int>(cameras.rings->heights.size()); ++i) ids.insert(i);
  for (const ListedCamera& c : cameras.list) ids.insert(c.id);
  return {ids.begin(), ids.end()};
}

void apply_overrides(SceneSpec& scene, const Overrides& o) {
  if (o.first_frame || o.last_frame) override_frames(scene, o);
  if (!o.cameras.empty()) scene.cameras.only = choose(o.cameras, all_camera_ids(scene.cameras), "--cameras");
  if (!o.coats.empty()) {
    std::vector<int> there;
    for (std::size_t i = 0; i < scene.animals.at(0).coats.size(); ++i) there.push_back(static_cast<int>(i));
    scene.coat_indices = choose(o.coats, there, "--coats");
  }
  if (!o.modalities.empty()) {
    try {
      scene.modalities = modalities_from_names(o.modalities);
    } catch (const InputError& e) {
      input_error("--modalities: {}", e.what());
    }
  }
  if (o.resolution) {
    const auto [width, height] = *o.resolution;
    if (width < 1 || height < 1 || width > largest_resolution || height > largest_resolution)
      input_error("--resolution: {}x{} is not possible; both sides must be from 1 to {}, e.g. 1024x768", width, height,
                  largest_resolution);
    scene.cameras.width = width;
    scene.cameras.height = height;
  }
  if (o.samples) {
    if (*o.samples < 1 || *o.samples > largest_samples)
      input_error("--spp: the samples per pixel must be from 1 to {}, not {}", largest_samples, *o.samples);
    scene.render.samples = *o.samples;
  }
  if (o.samples && !o.target_error) scene.render.target_error = 0;  // the samples asked for, not what an error needs
  if (o.target_error) {
    if (o.samples) input_error("--target-error and --spp: samples follow from the error; name one of the two");
    if (!(*o.target_error >= least_target_error) || *o.target_error > 1)
      input_error("--target-error: {} is not possible; from {} to 1, e.g. 0.02", *o.target_error, least_target_error);
    scene.render.target_error = *o.target_error;
  }
  if (o.surface_light) scene.render.surface_light = *o.surface_light;
  check_surface_light(scene);
  scene.resolved = scene_to_json(scene);
}

}  // namespace moomill
