#include "generator/dataset/json.h"

#include <cmath>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

bool is_plain(const Json& json) {
  return !json.is_structured() || json.empty();
}

bool fits_one_line(const Json& json) {
  if (is_plain(json)) return true;
  if (!json.is_array()) return false;
  for (const Json& item : json)
    if (!is_plain(item)) return false;
  return true;
}

void dump(const Json& json, int indent, std::string& out) {
  if (fits_one_line(json)) {
    out += json.dump(-1, ' ', false, Json::error_handler_t::replace);
    return;
  }
  const bool object = json.is_object();
  out += object ? '{' : '[';
  bool first = true;
  for (auto item = json.begin(); item != json.end(); ++item) {
    out += first ? "\n" : ",\n";
    first = false;
    out.append(static_cast<std::size_t>(indent) + 1, ' ');
    if (object) {
      out += Json(item.key()).dump(-1, ' ', false, Json::error_handler_t::replace);
      out += ": ";
    }
    dump(*item, indent + 1, out);
  }
  out += '\n';
  out.append(static_cast<std::size_t>(indent), ' ');
  out += object ? '}' : ']';
}

}  // namespace

std::string dump_json(const Json& json) {
  std::string out;
  dump(json, 0, out);
  out += '\n';
  return out;
}

std::string reason_of(const Json::exception& error) {
  const std::string text = error.what();
  const std::size_t end = text.find("] ");
  return text.starts_with("[json.exception") && end != std::string::npos ? text.substr(end + 2) : text;
}

Json parse_json(const std::string& text, const std::string& file) {
  try {
    return Json::parse(text);
  } catch (const Json::exception& e) {
    input_error("{}: is not valid JSON: {}; make the file anew", file, reason_of(e));
  }
}

Json parse_json_file(const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return parse_json(std::string(bytes.begin(), bytes.end()), file.string());
}

double number_from_json(const Json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

Json vector_to_json(const dvec3& v) {
  return Json::array({v.x, v.y, v.z});
}

dvec3 vector_from_json(const Json& json) {
  return {number_from_json(json.at(0)), number_from_json(json.at(1)), number_from_json(json.at(2))};
}

Json matrix_to_json(const dmat4& m) {
  Json rows = Json::array();
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) rows.push_back(m[c][r]);
  return rows;
}

dmat4 matrix_from_json(const Json& json) {
  dmat4 m(1.0);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) m[c][r] = number_from_json(json.at(static_cast<std::size_t>(4 * r + c)));
  return m;
}

Json camera_to_json(const CameraRecord& c) {
  Json json;
  json["id"] = c.id;
  json["centre_m"] = vector_to_json(c.centre);
  json["euler_xyz_rad"] = vector_to_json(c.euler_xyz);
  json["focal_mm"] = c.focal_mm;
  json["sensor_mm"] = c.sensor_mm;
  json["width"] = c.width;
  json["height"] = c.height;
  json["world_to_camera"] = c.world_to_camera;
  json["fx"] = c.fx;
  json["fy"] = c.fy;
  json["cx"] = c.cx;
  json["cy"] = c.cy;
  return json;
}

CameraRecord camera_from_json(const Json& json) {
  CameraRecord c;
  c.id = json.at("id").get<int>();
  c.centre = vector_from_json(json.at("centre_m"));
  c.euler_xyz = vector_from_json(json.at("euler_xyz_rad"));
  c.focal_mm = json.at("focal_mm").get<double>();
  c.sensor_mm = json.at("sensor_mm").get<double>();
  c.width = json.at("width").get<int>();
  c.height = json.at("height").get<int>();
  c.world_to_camera = json.at("world_to_camera").get<std::array<double, 12>>();
  c.fx = json.at("fx").get<double>();
  c.fy = json.at("fy").get<double>();
  c.cx = json.at("cx").get<double>();
  c.cy = json.at("cy").get<double>();
  return c;
}

}  // namespace moomill
