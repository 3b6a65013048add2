#include "generator/dataset/tables.h"

#include <algorithm>

#include "generator/core/error.h"

namespace moomill {
namespace {

// INI and CSV are read by anything: nothing but letters, digits and underscores in a name, so no '#', no ','.
std::string plain(std::string name) {
  for (char& c : name)
    if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
  return name;
}

}  // namespace

std::string keypoints_csv_header(const Manifest& m) {
  std::string out = "frame";
  for (const std::string& name : m.keypoint_names)
    for (const char* axis : {"x", "y", "z"}) out += fmt::format(",{}_{}", plain(name), axis);
  return out + "\n";
}

std::string keypoints_csv_row(int frame, const std::vector<dvec3>& keypoints) {
  std::string out = std::to_string(frame);
  for (const dvec3& p : keypoints) out += fmt::format(",{},{},{}", p.x, p.y, p.z);
  return out + "\n";
}

std::string parameters_cfg(const Manifest& m, const std::vector<CameraRecord>& cameras) {
  std::string out;
  if (m.per_frame_cameras)
    out +=
        "# The cameras of this dataset vary from frame to frame: here are those of its first frame; those of every\n"
        "# frame are in frames/<frame>.json.\n";
  if (cameras.empty()) return out;
  const CameraRecord& first = cameras.front();
  out += fmt::format(
      "[intrinsics]\nfocal_length_mm = {}\nimage_resolution_x_px = {}\nimage_resolution_y_px = {}\nsensor_size_mm = "
      "{}\n",
      first.focal_mm, first.width, first.height, first.sensor_mm);
  for (const CameraRecord& c : cameras) {
    out += fmt::format("\n[extrinsics_Camera.{:03}]\n", c.id);
    for (int i = 0; i < 3; ++i) out += fmt::format("center_cam_{}_m = {}\n", "xyz"[i], c.centre[i]);
    for (int i = 0; i < 3; ++i) out += fmt::format("center_cam_r{}_rad = {}\n", "xyz"[i], c.euler_xyz[i]);
    // The public loader knows one lens; where a camera has another, it is said here, for other readers.
    if (c.focal_mm != first.focal_mm) out += fmt::format("focal_length_mm = {}\n", c.focal_mm);
    if (c.sensor_mm != first.sensor_mm) out += fmt::format("sensor_size_mm = {}\n", c.sensor_mm);
    if (c.width != first.width || c.height != first.height)
      out += fmt::format("image_resolution_x_px = {}\nimage_resolution_y_px = {}\n", c.width, c.height);
  }
  return out;
}

}  // namespace moomill
