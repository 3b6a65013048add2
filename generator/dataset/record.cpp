// frames/<frame>.json: all that is particular to one frame.
#include <algorithm>

#include "generator/core/error.h"
#include "generator/dataset/json.h"

namespace moomill {
namespace {

constexpr const char* causes[] = {"nothing", "self", "other_animal", "scenery", "off_frame"};

Json keypoints_to_json(const std::vector<KeypointView>& keypoints) {
  Json pixel = Json::array(), depth = Json::array(), visibility = Json::array(), cause = Json::array(),
       occluder = Json::array(), margin = Json::array();
  for (const KeypointView& k : keypoints) {
    pixel.push_back({k.pixel.x, k.pixel.y});
    depth.push_back(k.depth);
    visibility.push_back(static_cast<int>(k.visibility));
    cause.push_back(causes[static_cast<int>(k.cause)]);
    occluder.push_back(k.occluder);
    margin.push_back(k.margin);
  }
  return {{"pixel", pixel}, {"depth_m", depth},     {"visibility", visibility},
          {"cause", cause}, {"occluder", occluder}, {"margin_m", margin}};
}

std::vector<KeypointView> keypoints_from_json(const Json& json) {
  std::vector<KeypointView> out(json.at("pixel").size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    KeypointView& k = out[i];
    k.pixel = {number_from_json(json.at("pixel").at(i).at(0)), number_from_json(json.at("pixel").at(i).at(1))};
    k.depth = number_from_json(json.at("depth_m").at(i));
    const int visibility = json.at("visibility").at(i).get<int>();
    if (visibility < 0 || visibility > 2) throw std::runtime_error("a visibility is not 0, 1 or 2");
    k.visibility = static_cast<Visibility>(visibility);
    const std::string cause = json.at("cause").at(i).get<std::string>();
    const auto found = std::find(std::begin(causes), std::end(causes), cause);
    if (found == std::end(causes)) throw std::runtime_error("unknown cause \"" + cause + "\"");
    k.cause = static_cast<HiddenBy>(found - std::begin(causes));
    k.occluder = json.at("occluder").at(i).get<int>();
    k.margin = number_from_json(json.at("margin_m").at(i));
  }
  return out;
}

Json view_to_json(const View& view) {
  Json animals = Json::array();
  for (std::size_t a = 0; a < std::max(view.keypoints.size(), view.occlusion.size()); ++a) {
    Json animal = Json::object();
    if (a < view.keypoints.size()) animal["keypoints"] = keypoints_to_json(view.keypoints[a]);
    if (a < view.occlusion.size()) {
      const OcclusionView& o = view.occlusion[a];
      animal["occlusion"] = {{"whole_pixels", o.whole_pixels},
                             {"visible_pixels", o.visible_pixels},
                             {"hidden_fraction", o.hidden_fraction},
                             {"occluded_pixels", o.occluded}};
    }
    animals.push_back(animal);
  }
  return {{"camera", view.camera}, {"width", view.width}, {"height", view.height}, {"animals", animals}};
}

View view_from_json(const Json& json, int frame) {
  View view;
  view.frame = frame;
  view.camera = json.at("camera").get<int>();
  view.width = json.at("width").get<int>();
  view.height = json.at("height").get<int>();
  for (const Json& animal : json.at("animals")) {
    if (animal.contains("keypoints")) view.keypoints.push_back(keypoints_from_json(animal.at("keypoints")));
    if (animal.contains("occlusion")) {
      const Json& o = animal.at("occlusion");
      OcclusionView& out = view.occlusion.emplace_back();
      out.whole_pixels = o.at("whole_pixels").get<std::uint64_t>();
      out.visible_pixels = o.at("visible_pixels").get<std::uint64_t>();
      out.hidden_fraction = o.at("hidden_fraction").get<double>();
      out.occluded = o.at("occluded_pixels").get<std::vector<std::uint64_t>>();
    }
  }
  return view;
}

}  // namespace

std::string record_text(const StoredFrame& stored) {
  const FrameRecord& f = stored.frame;
  Json animals = Json::array();
  const std::size_t count =
      std::max({f.keypoints.size(), f.bones.size(), f.placement.size(), f.morph_weights.size(), f.bone_names.size()});
  for (std::size_t a = 0; a < count; ++a) {
    Json animal = Json::object();
    if (a < f.keypoints.size()) {
      Json points = Json::array();
      for (const dvec3& p : f.keypoints[a]) points.push_back(vector_to_json(p));
      animal["keypoints_m"] = points;
    }
    if (a < f.bones.size()) {
      Json bones = Json::array();
      for (const dmat4& m : f.bones[a]) bones.push_back(matrix_to_json(m));
      animal["bones"] = bones;
    }
    if (a < f.bone_names.size()) animal["bone_names"] = f.bone_names[a];
    if (a < f.placement.size()) animal["placement"] = matrix_to_json(f.placement[a]);
    if (a < f.morph_weights.size()) animal["morph_weights"] = f.morph_weights[a];
    animals.push_back(animal);
  }
  Json views = Json::array();
  for (const View& view : stored.views) views.push_back(view_to_json(view));
  Json files = Json::object();
  for (const auto& [path, file] : stored.files) files[path] = Json::array({file.bytes, file.xxh64});
  Json json = {{"frame", f.frame}, {"animals", animals}, {"views", views}, {"files", files}};
  if (!f.cameras.empty()) {
    Json cameras = Json::array();
    for (const CameraRecord& c : f.cameras) cameras.push_back(camera_to_json(c));
    json["cameras"] = cameras;
  }
  if (!f.drawn.is_null()) json["drawn"] = f.drawn;
  return dump_json(json);
}

StoredFrame record_from_text(const std::string& text, const std::string& file) {
  const Json json = parse_json(text, file);
  StoredFrame stored;
  FrameRecord& f = stored.frame;
  try {
    f.frame = json.at("frame").get<int>();
    for (const Json& animal : json.at("animals")) {
      if (animal.contains("keypoints_m")) {
        f.keypoints.emplace_back();
        for (const Json& p : animal.at("keypoints_m")) f.keypoints.back().push_back(vector_from_json(p));
      }
      if (animal.contains("bones")) {
        f.bones.emplace_back();
        for (const Json& m : animal.at("bones")) f.bones.back().push_back(matrix_from_json(m));
      }
      if (animal.contains("bone_names"))
        f.bone_names.push_back(animal.at("bone_names").get<std::vector<std::string>>());
      if (animal.contains("placement")) f.placement.push_back(matrix_from_json(animal.at("placement")));
      if (animal.contains("morph_weights"))
        f.morph_weights.push_back(animal.at("morph_weights").get<std::vector<double>>());
    }
    if (json.contains("cameras"))
      for (const Json& c : json.at("cameras")) f.cameras.push_back(camera_from_json(c));
    if (json.contains("drawn")) f.drawn = json.at("drawn");
    for (const Json& view : json.at("views")) stored.views.push_back(view_from_json(view, f.frame));
    for (const auto& [path, entry] : json.at("files").items()) {
      if (path.starts_with('/') || path.find("..") != std::string::npos)
        throw std::runtime_error("the file \"" + path + "\" is outside the dataset");
      stored.files[path] = {entry.at(0).get<std::uint64_t>(), entry.at(1).get<std::string>()};
    }
  } catch (const std::exception& e) {
    input_error("{}: is not a frame record: {}; make the frame anew", file, e.what());
  }
  return stored;
}

}  // namespace moomill
