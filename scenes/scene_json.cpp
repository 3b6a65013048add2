// A scene with its defaults filled in, as JSON: what manifests carry.
#include "scenes/scene.h"

namespace moomill {
namespace {

// Absolute paths differ from machine to machine; the file's name is all that is kept of them.
std::string portable_path(const std::string& path) {
  const std::filesystem::path p(path);
  return p.is_absolute() ? p.filename().string() : path;
}

Json entry(const std::vector<double>& v) {
  return v.size() == 1 ? Json(v[0]) : Json(v);
}

Json to_json(const Distribution& d) {
  Json list = Json::array();
  for (const std::string& w : d.words) list.push_back(portable_path(w));
  for (const std::vector<double>& v : d.values) list.push_back(entry(v));
  if (d.is_constant()) return list.empty() ? Json(nullptr) : list[0];
  Json out;
  switch (d.kind) {
    case Choice::Kind::constant:
      break;
    case Choice::Kind::uniform:
      out["uniform"] = list;
      break;
    case Choice::Kind::log_uniform:
      out["log_uniform"] = list;
      break;
    case Choice::Kind::choose:
      out["choose"] = list;
      break;
    case Choice::Kind::normal:
      out["normal"] = {list[0], list[1]};
      if (list.size() > 2) out["clamp"] = {list[2], list[3]};
      break;
  }
  out["per"] = d.per_view ? "view" : "frame";
  return out;
}

Json to_json(const PoseSource& source) {
  if (const auto* clip = std::get_if<ClipFrames>(&source)) 
    return {{"clip", clip->clip}, {"count", clip->count}, {"treadmill", clip->treadmill}};
  if (const auto* file = std::get_if<PoseFile>(&source)) {
    Json out{{"file", portable_path(file->file)}};
    // The poses themselves decide the frames, so they are part of what the scene says.
    if (file->poses) out["poses"] = *file->poses;
    return out;
  }
  const PoseSampler& sampler = std::get<PoseSampler>(source);
  return {{"random", sampler.count}, {"spread", sampler.spread}, {"on_ground", sampler.on_ground}};
}

// Runs of individuals as the tables they were asked for by.
Json coats_to_json(const AnimalSpec& a) {
  Json out = Json::array();
  for (std::size_t i = 0; i < a.coats.size(); ++i) {
    const Individual* one = a.individual(i);
    if (!one) {
      out.push_back(portable_path(a.coats[i]));
      continue;
    }
    int count = 1;
    while (const Individual* next = a.individual(i + count)) {
      if (next->breed != one->breed || next->seed != one->seed || next->index != one->index + count) break;
      ++count;
    }
    out.push_back({{"breed", portable_path(one->breed)}, {"seed", one->seed}, {"first", one->index}, {"count", count}});
    i += static_cast<std::size_t>(count) - 1;
  }
  return out;
}

Json to_json(const AnimalSpec& a) {
  Json out{{"species", portable_path(a.species)},
           {"position", to_json(a.position)},
           {"yaw_deg", to_json(a.yaw_deg)},
           {"pose_in_place", a.pose_in_place}};
  out["coats"] = coats_to_json(a);
  out["poses"] = Json::array();
  for (const PoseSource& p : a.poses) out["poses"].push_back(to_json(p));
  return out;
}

Json to_json(const CameraSpec& c) {
  Json out{{"target", to_json(c.target)},
           {"focal_mm", to_json(c.focal_mm)},
           {"sensor_mm", c.sensor_mm},
           {"resolution", {c.width, c.height}}};
  if (!c.only.empty()) out["only"] = c.only;
  if (c.rings)
    out["rings"] = {{"count", c.rings->count},
                    {"radius", to_json(c.rings->radius)},
                    {"heights", c.rings->heights},
                    {"first_azimuth_deg", c.rings->first_azimuth_deg}};
  for (const ListedCamera& l : c.list) {
    Json camera{{"id", l.id}, {"position", to_json(l.position)}};
    if (l.target) camera["target"] = to_json(*l.target);
    out["list"].push_back(std::move(camera));
  }
  return out;
}

Json to_json(const LightSpec& light) {
  Json out{{"environment_color", to_json(light.environment_color)},
           {"environment_strength", to_json(light.environment_strength)},
           {"environment_yaw_deg", to_json(light.environment_yaw_deg)},
           {"suns", Json::array()},
           {"rectangles", Json::array()}};
  if (light.environment_file) out["environment_file"] = to_json(*light.environment_file);
  for (const LightSpec::Sun& s : light.suns)
    out["suns"].push_back({{"azimuth_deg", to_json(s.azimuth_deg)},
                           {"elevation_deg", to_json(s.elevation_deg)},
                           {"irradiance", to_json(s.irradiance)},
                           {"color", to_json(s.color)},
                           {"angular_diameter_deg", to_json(s.angular_diameter_deg)}});
  for (const LightSpec::Rectangle& r : light.rectangles)
    out["rectangles"].push_back({{"position", to_json(r.position)},
                                 {"target", to_json(r.target)},
                                 {"radiance", to_json(r.radiance)},
                                 {"color", to_json(r.color)},
                                 {"width", r.width},
                                 {"height", r.height}});
  return out;
}

const char* name_of(BackgroundSpec::Kind kind) {
  switch (kind) {
    case BackgroundSpec::Kind::transparent:
      return "transparent";
    case BackgroundSpec::Kind::color:
      return "color";
    case BackgroundSpec::Kind::environment:
      return "environment";
    case BackgroundSpec::Kind::image:
      return "image";
  }
  return "";
}

// {first, every, count} where the frames are evenly spaced, else the list.
Json frames_to_json(const SceneSpec& scene) {
  const std::vector<int>& f = scene.frames;
  Json out{{"number_from", scene.first_frame}};
  const int every = f.size() > 1 ? f[1] - f[0] : 1;
  bool even = !f.empty();
  for (std::size_t i = 1; i < f.size(); ++i) even = even && f[i] - f[i - 1] == every;
  if (even) {
    out["first"] = f[0];
    out["every"] = every;
    out["count"] = f.size();
  } else {
    out["list"] = f;
  }
  return out;
}

}  // namespace

Json scene_to_json(const SceneSpec& scene) {
  Json out;
  out["seed"] = scene.seed;
  out["subset"] = scene.subset == Subset::main          ? "main"
                  : scene.subset == Subset::novel_views ? "novel_views"
                                                        : "occlusions";
  out["modalities"] = Json::array();
  for (const ModalityRow& r : modality_table())
    if (scene.modalities.has(r.id)) out["modalities"].push_back(r.name);
  out["frames"] = frames_to_json(scene);
  out["animals"] = Json::array();
  for (const AnimalSpec& a : scene.animals) out["animals"].push_back(to_json(a));
  out["only_coats"] = scene.coat_indices;
  out["cameras"] = to_json(scene.cameras);
  out["light"] = to_json(scene.light);
  out["background"] = {{"kind", name_of(scene.background.kind)}, {"color", to_json(scene.background.color)}};
  if (scene.background.image) out["background"]["image"] = to_json(*scene.background.image);
  out["ground"] = {{"present", scene.ground.present}};
  if (scene.ground.present) {
    out["ground"]["color"] = to_json(scene.ground.color);
    out["ground"]["roughness"] = to_json(scene.ground.roughness);
    out["ground"]["size"] = scene.ground.size;
  }
  out["render"] = {{"samples", scene.render.samples},
                   {"target_error", scene.render.target_error},
                   {"max_bounces", scene.render.max_bounces},
                   {"filter_radius", scene.render.filter_radius},
                   {"surface_light", scene.render.surface_light},
                   {"coat_resolution", scene.render.coat_resolution}};
  out["nnopcs"] = {{"normalization", scene.normalization == NnopcsNormalization::box ? "box" : "diagonal"}};
  return out;
}

}  // namespace moomill
