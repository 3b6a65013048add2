// manifest.json: all that is the same for every frame.
#include <algorithm>

#include "generator/core/error.h"
#include "generator/dataset/json.h"

namespace moomill {
namespace {

constexpr const char* schema = "moomill-dataset";
constexpr int schema_version = 1;

constexpr const char* subset_names[] = {"main", "novel_views", "occlusions"};

const char* storage_name(Storage storage) {
  switch (storage) {
    case Storage::jpeg8:
      return "JPEG, 8-bit sRGB, quality 95, no chroma subsampling";
    case Storage::png8:
      return "PNG, 8 bits";
    case Storage::png16:
      return "PNG, 16 bits";
    case Storage::exr32:
      return "EXR, float32";
    case Storage::exr_ids:
      return "EXR, uint32 ids and float32 barycentrics";
    case Storage::record:
      return "per-frame record";
  }
  return "";
}

Json conventions() {
  return {
      {"world", "right-handed, Z up, metres"},
      {"camera",
       "OpenCV axes (x right, y down, z forward); world_to_camera is 3x4, row-major; fx, fy, cx, cy in pixels"},
      {"euler_xyz_rad", "XYZ Euler angles of a Blender camera, which looks along its -Z with +Y up"},
      {"pixels",
       "pixel (i, j) covers [i, i+1) x [j, j+1), its centre is (i + 0.5, j + 0.5); a centred lens has cx = width / 2"},
      {"depth", "camera z in metres at the pixel centre, not the distance along the ray"},
      {"labels",
       "never filtered: one ray through the pixel centre decides silhouette, depth, NNOPCS, normal, uv, part, "
       "instance and triangle of a pixel"},
      {"nnopcs", "coordinates of the surface point in the neutral pose, normalised to [0, 1] by nnopcs.normalization"},
      {"nnopcs8", "round(255 v); foreground components that round to 0 are written as 1"},
      {"keypoints_3d", "world metres"},
      {"keypoints_2d", "pixels, as above"},
      {"visibility", "0 outside the image, 1 hidden, 2 visible"},
      {"margin", "metres that a keypoint lies behind the nearest surface along its ray; negative in front of it"},
      {"bones", "skinning matrices, bind-pose model space to world, 3x4 row-major"},
      {"color", "8-bit colour is sRGB; light is computed in linear Rec. 709"},
      {"frames", "numbered as in the file names"},
      {"public_loader",
       "it takes the principal point at width / 2 + 0.5, height / 2 + 0.5 and its pixel queries at index / "
       "size, one pixel apart in all; files here hold the true camera"},
  };
}

Json paths(const Manifest& m) {
  Json out;
  for (const ModalityRow& r : modality_table()) {
    if (!m.modalities.has(r.id) || r.storage == Storage::record) continue;
    if (r.per_coat) {
      Json by_coat = Json::object();
      for (int coat : m.coat_indices) by_coat[std::to_string(coat)] = path_template(m, r.id, coat, -1);
      out[r.name] = by_coat;
    } else if (r.id == Modality::occlusion) {
      Json by_animal = Json::object();
      for (int animal = 0; animal < std::max(1, static_cast<int>(m.animals.size())); ++animal)
        by_animal[std::to_string(animal)] = path_template(m, r.id, -1, animal);
      out[r.name] = by_animal;
    } else {
      out[r.name] = path_template(m, r.id, -1, -1);
    }
  }
  if (m.modalities.has(Modality::nnopcs)) out["nnopcs8"] = nnopcs8_template(m);
  out["record"] = record_template();
  out["keypoints_csv"] = keypoints_csv_path(m);
  out["parameters_cfg"] = parameters_cfg_path(m);
  return out;
}

Json modalities(const Manifest& m) {
  Json out = Json::array();
  for (const ModalityRow& r : modality_table()) {
    if (!m.modalities.has(r.id)) continue;
    Json entry = {{"name", r.name},        {"channels", r.channels},     {"storage", storage_name(r.storage)},
                  {"unit", r.unit},        {"background", r.background}, {"about", r.about},
                  {"per_coat", r.per_coat}};
    if (r.storage == Storage::exr32 || r.storage == Storage::exr_ids) entry["exr_channels"] = exr_channel_names(r.id);
    out.push_back(entry);
  }
  return out;
}

}  // namespace

Json manifest_identity(const Manifest& m) {
  Json json;
  json["schema"] = schema;
  json["schema_version"] = schema_version;
  json["program_version"] = MOOMILL_VERSION;
  json["species"] = m.species;
  json["subset"] = subset_names[static_cast<int>(m.subset)];
  json["seed"] = m.seed;
  json["scene"] = m.scene;
  json["conventions"] = conventions();
  Json cameras = Json::array();
  for (const CameraRecord& c : m.cameras) cameras.push_back(camera_to_json(c));
  json["cameras"] = cameras;
  json["per_frame_cameras"] = m.per_frame_cameras;
  json["coats"] = m.coats;
  json["coat_indices"] = m.coat_indices;
  if (!m.individuals.empty()) {
    Json list = Json::array();
    for (std::size_t i = 0; i < m.individuals.size(); ++i)
      if (const auto& one = m.individuals[i])
        list.push_back({{"coat", i}, {"breed", one->breed}, {"seed", one->seed}, {"index", one->index}});
    json["individuals"] = list;
  }
  json["animals"] = m.animals;
  json["labelled_animal"] = labelled_animal;
  json["keypoints"] = {{"names", m.keypoint_names},
                       {"skeleton", m.skeleton},
                       {"left_right_pairs", m.pairs},
                       {"tolerance_m", m.keypoint_tolerance}};
  json["parts"] = m.part_names;
  json["frames"] = m.frames;
  const Splits splits = make_splits(m.frames);
  json["splits"] = {{"train", splits.train}, {"validate", splits.validate}, {"test", splits.test}};
  json["modalities"] = modalities(m);
  json["nnopcs"] = {{"lower_m", vector_to_json(m.nnopcs_lower)},
                    {"upper_m", vector_to_json(m.nnopcs_upper)},
                    {"normalization", m.nnopcs_normalization}};
  json["skinning"] = m.skinning;
  Json rigs = Json::array();
  for (int a = 0; a < static_cast<int>(m.animals.size()); ++a) rigs.push_back(rig_path(m, a));
  json["rig_files"] = rigs;
  json["reader_radius_m"] = m.reader_radius;
  json["paths"] = paths(m);
  return json;
}

Json manifest_to_json(const Manifest& m) {
  Json json = manifest_identity(m);
  if (!m.held_frames.empty() && m.held_frames != m.frames) json["held_frames"] = m.held_frames;
  return json;
}

Manifest manifest_from_json(const Json& json, const std::string& file) {
  if (!json.is_object() || json.value("schema", Json()) != schema)
    input_error("{}: is not a manifest of moomill (its \"schema\" is not \"{}\"); point at a dataset folder", file,
                schema);
  if (json.value("schema_version", Json()) != schema_version)
    input_error("{}: has schema version {} where this program reads {}; use the program version that made it", file,
                json.value("schema_version", Json()).dump(), schema_version);
  Manifest m;
  std::string key;
  const auto at = [&](const char* name) -> const Json& {
    key = name;
    return json.at(name);
  };
  try {
    m.species = at("species").get<std::string>();
    const std::string subset = at("subset").get<std::string>();
    const auto found = std::find(std::begin(subset_names), std::end(subset_names), subset);
    if (found == std::end(subset_names))
      input_error("{}: \"subset\" is \"{}\"; it must be main, novel_views or occlusions", file, subset);
    m.subset = static_cast<Subset>(found - std::begin(subset_names));
    m.seed = at("seed").get<std::uint64_t>();
    m.scene = at("scene");
    for (const Json& c : at("cameras")) m.cameras.push_back(camera_from_json(c));
    m.per_frame_cameras = at("per_frame_cameras").get<bool>();
    m.coats = at("coats").get<std::vector<std::string>>();
    m.coat_indices = at("coat_indices").get<std::vector<int>>();
    if (json.contains("individuals")) {
      m.individuals.resize(m.coats.size());
      for (const Json& one : at("individuals")) {
        const int coat = one.at("coat").get<int>();
        if (coat < 0 || coat >= static_cast<int>(m.coats.size()))
          input_error("{}: \"individuals\" names coat {} of {}; make the dataset anew", file, coat, m.coats.size());
        m.individuals[coat] = Individual{one.at("breed").get<std::string>(), one.at("seed").get<std::uint64_t>(),
                                         one.at("index").get<int>()};
      }
    }
    m.animals = at("animals").get<std::vector<std::string>>();
    const Json& keypoints = at("keypoints");
    m.keypoint_names = keypoints.at("names").get<std::vector<std::string>>();
    m.skeleton = keypoints.at("skeleton").get<std::vector<std::pair<int, int>>>();
    m.pairs = keypoints.at("left_right_pairs").get<std::vector<std::pair<int, int>>>();
    m.keypoint_tolerance = keypoints.at("tolerance_m").get<std::vector<double>>();
    for (const auto* edges : {&m.skeleton, &m.pairs})
      for (const auto& [a, b] : *edges)
        if (std::min(a, b) < 0 || std::max(a, b) >= static_cast<int>(m.keypoint_names.size()))
          input_error("{}: \"keypoints\" has an edge to keypoint {} of {}; make the dataset anew", file, std::max(a, b),
                      m.keypoint_names.size());
    m.part_names = at("parts").get<std::vector<std::string>>();
    m.frames = at("frames").get<std::vector<int>>();
    m.held_frames = json.contains("held_frames") ? at("held_frames").get<std::vector<int>>() : m.frames;
    for (const Json& entry : at("modalities")) {
      const std::string name = entry.at("name").get<std::string>();
      const std::optional<Modality> modality = modality_from_name(name);
      if (!modality) input_error("{}: \"modalities\" has \"{}\", unknown to this program; use a newer one", file, name);
      m.modalities.add(*modality);
    }
    const Json& nnopcs = at("nnopcs");
    m.nnopcs_lower = vector_from_json(nnopcs.at("lower_m"));
    m.nnopcs_upper = vector_from_json(nnopcs.at("upper_m"));
    m.nnopcs_normalization = nnopcs.at("normalization").get<std::string>();
    m.skinning = at("skinning").get<std::string>();
    m.rig_files = at("rig_files").get<std::vector<std::string>>();
    m.reader_radius = at("reader_radius_m").get<double>();
  } catch (const Json::exception& e) {
    input_error("{}: \"{}\" is missing or wrong ({}); make the dataset anew", file, key, reason_of(e));
  }
  return m;
}

}  // namespace moomill
