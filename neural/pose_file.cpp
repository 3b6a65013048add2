#include "neural/pose_file.h"

#include <cmath>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "neural/report.h"

namespace moomill {

namespace fs = std::filesystem;
using torch::Tensor;

namespace {

double finite(const Json& json, const fs::path& file, const std::string& place) {
  if (!json.is_number() || !(std::abs(json.get<double>()) <= 1e9))  // metres and pixels; beyond, float loses the animal
    input_error("{}, {}: is not a number within 1e9; give one", file.string(), place);
  return json.get<double>();
}

const Json& member(const Json& json, const char* key, const fs::path& file, const char* of) {
  if (!json.is_object() || !json.contains(key)) input_error("{}: {} has no \"{}\"; add it", file.string(), of, key);
  return json.at(key);
}

CameraRecord read_camera(const Json& json, const fs::path& file) {
  CameraRecord camera;
  camera.id = -1;
  Json matrix = member(json, "world_to_camera", file, "the camera");
  if (matrix.is_array() && !matrix.empty() && matrix[0].is_array()) {
    Json flat = Json::array();
    for (const Json& row : matrix)
      for (const Json& value : row) flat.push_back(value);
    matrix = flat;
  }
  if (!matrix.is_array() || matrix.size() != 12)
    input_error("{}, \"world_to_camera\": is not a 3 x 4 matrix; give three rows of four numbers", file.string());
  for (std::size_t i = 0; i < 12; ++i) camera.world_to_camera[i] = finite(matrix[i], file, "\"world_to_camera\"");
  const auto dot = [&](int a, int b) {
    double sum = 0;
    for (int i = 0; i < 3; ++i)
      sum += camera.world_to_camera[static_cast<std::size_t>(4 * a + i)] *
             camera.world_to_camera[static_cast<std::size_t>(4 * b + i)];
    return sum;
  };
  const auto& m = camera.world_to_camera;
  const double determinant =
      m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b <= a; ++b)
      if (std::abs(dot(a, b) - (a == b)) > 1e-3 || determinant < 0)
        input_error(
            "{}, \"world_to_camera\": its left three columns are no rotation; give [R | t] with x_camera = R x_world + "
            "t",
            file.string());
  const auto positive = [&](const char* key) {
    const double value = finite(member(json, key, file, "the camera"), file, std::string("\"") + key + "\"");
    if (value <= 0) input_error("{}, \"{}\": {} is not above 0; give pixels", file.string(), key, value);
    return value;
  };
  camera.fx = positive("fx");
  camera.fy = positive("fy");
  camera.cx = finite(member(json, "cx", file, "the camera"), file, "\"cx\"");
  camera.cy = finite(member(json, "cy", file, "the camera"), file, "\"cy\"");
  const auto size = [&](const char* key) {
    const double value = positive(key);
    if (value != std::floor(value) || value > 16384)
      input_error("{}, \"{}\": {} is not a whole number of pixels from 1 to 16384; give one", file.string(), key,
                  value);
    return static_cast<int>(value);
  };
  camera.width = size("width");
  camera.height = size("height");
  return camera;
}

}  // namespace

PoseFile read_pose_file(const fs::path& file) {
  const Json json = parse_json_file(file);
  if (!json.is_object())
    input_error("{}: is not a JSON object; give {{\"keypoints\": [[x, y, z], ...]}}", file.string());
  PoseFile pose;
  if (json.contains("keypoints")) {
    const Json& list = json.at("keypoints");
    if (!list.is_array() || list.empty())
      input_error("{}, \"keypoints\": is not a list of [x, y, z]; give one", file.string());
    pose.keypoints = torch::empty({static_cast<std::int64_t>(list.size()), 3});
    for (std::size_t k = 0; k < list.size(); ++k) {
      if (!list[k].is_array() || list[k].size() != 3)
        input_error("{}, keypoint {}: is not [x, y, z]; give three numbers in world metres", file.string(), k);
      for (std::size_t i = 0; i < 3; ++i)
        pose.keypoints[static_cast<std::int64_t>(k)][static_cast<std::int64_t>(i)] =
            finite(list[k][i], file, "keypoint " + std::to_string(k));
    }
  }
  if (json.contains("camera")) pose.camera = read_camera(json.at("camera"), file);
  return pose;
}

CameraRecord read_camera_file(const fs::path& file) {
  const Json json = parse_json_file(file);
  return read_camera(json.is_object() && json.contains("camera") ? json.at("camera") : json, file);
}

CameraRecord resized(const CameraRecord& camera, int width, int height) {
  CameraRecord out = camera;
  const double x = static_cast<double>(width) / camera.width, y = static_cast<double>(height) / camera.height;
  out.width = width;
  out.height = height;
  out.fx *= x;
  out.cx *= x;
  out.fy *= y;
  out.cy *= y;
  return out;
}

Photo read_photo(const fs::path& picture, const fs::path& mask) {
  const Image8 image = read_image8(picture), silhouette = read_image8(mask);
  if (image.width != silhouette.width || image.height != silhouette.height)
    input_error("{}: is {} x {} pixels, {} {} x {}; give a mask of the picture's size", mask.string(), silhouette.width,
                silhouette.height, picture.string(), image.width, image.height);
  Photo photo;
  photo.color = tensor_of(image);
  if (photo.color.size(0) < 3)
    photo.color = photo.color[0].unsqueeze(0).expand({3, image.height, image.width}).contiguous();
  photo.mask = (tensor_of(silhouette)[0] > 0.5).to(torch::kFloat);
  if (photo.mask.sum().item<double>() == 0)
    input_error("{}: no pixel of the mask is above half; paint the animal white", mask.string());
  return photo;
}

}  // namespace moomill
