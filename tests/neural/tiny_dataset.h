#pragma once
// A tiny dataset whose every number is known: an ellipsoid that turns, moves and stretches from frame to frame, seen by
// rings of eight cameras. Depth, NNOPCS, silhouette, colour and keypoints follow from one quadratic equation, so that
// nothing of the renderer is needed. Include tests/neural/doctest_torch.h first.
#include <cmath>
#include <functional>
#include <optional>

#include "generator/core/random.h"
#include "tests/dataset/helpers.h"

namespace moomill::test {

struct TinyOptions {
  int frames = 24;  // numbered from 1; 10 or more for a training split, 51 or more for a validation split
  int rings = 3;
  int width = 32, height = 24;  // pixels
  int coats = 3;
  bool nnopcs = true;
  std::string species = "cow";
  dvec3 shift{0};                   // metres, of all cameras: off the Z axis their rings cannot be turned
  std::uint64_t seed = 1;           // of the poses
  std::function<void(View&)> edit;  // changes a view before it is written
};

struct TinyPose {
  dmat3 to_world;  // from the unit sphere; glm is column-major
  dvec3 centre;    // metres
};

inline TinyPose tiny_pose(int frame, std::uint64_t seed = 1) {
  const auto unit = [&](std::uint64_t i) {
    return to_unit(hash_identity({seed, static_cast<std::uint64_t>(frame), i}));
  };
  const double yaw = 2 * pi * unit(0), c = std::cos(yaw), s = std::sin(yaw);
  const dvec3 axes(0.45 * (0.8 + 0.4 * unit(1)), 0.22 * (0.8 + 0.4 * unit(2)), 0.3 * (0.8 + 0.4 * unit(3)));
  TinyPose pose;
  pose.to_world = dmat3(axes.x * dvec3(c, s, 0), axes.y * dvec3(-s, c, 0), axes.z * dvec3(0, 0, 1));
  pose.centre = {0.2 * (unit(4) - 0.5), 0.2 * (unit(5) - 0.5), 0.1 * (unit(6) - 0.5)};
  return pose;
}

// Where a world point lies in the sphere of radius 1 that the animal is made of; NNOPCS is half of it plus a half.
inline dvec3 tiny_sphere_point(const TinyPose& pose, const dvec3& world) {
  return glm::inverse(pose.to_world) * (world - pose.centre);
}

inline std::vector<dvec3> tiny_keypoints(const TinyPose& pose) {
  std::vector<dvec3> out;
  for (const dvec3& p :
       {dvec3(0), dvec3(0.8, 0, 0), dvec3(-0.8, 0, 0), dvec3(0, 0.8, 0), dvec3(0, -0.8, 0), dvec3(0, 0, 0.8),
        dvec3(0, 0, -0.8), dvec3(0.5, 0.4, 0.4), dvec3(0.5, -0.4, -0.4), dvec3(-0.5, 0.4, -0.4)})
    out.push_back(pose.to_world * p + pose.centre);
  return out;
}

// Looks at the origin (before the shift), without roll; turning the world by 45 degrees about Z maps each azimuth to
// the next.
inline CameraRecord tiny_camera(int id, const TinyOptions& o) {
  constexpr double elevations[] = {5, 25, 50};
  const double e = elevations[id / 8 % 3] * degrees, a = (45 * (id % 8) + 10) * degrees,
               distance = 4.5 + 0.5 * (id / 8);
  const dvec3 from(distance * std::cos(e) * std::cos(a), distance * std::cos(e) * std::sin(a), distance * std::sin(e));
  CameraRecord c;
  c.id = id;
  c.centre = from + o.shift;
  c.width = o.width;
  c.height = o.height;
  c.euler_xyz = {std::atan2(std::hypot(from.x, from.y), from.z), 0, std::atan2(from.x, -from.y)};
  const dvec3 forward = -glm::normalize(from), right = glm::normalize(glm::cross(forward, dvec3(0, 0, 1)));
  const dvec3 rows[3] = {right, glm::cross(forward, right), forward};
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) c.world_to_camera[4 * r + k] = rows[r][k];
    c.world_to_camera[4 * r + 3] = -glm::dot(rows[r], c.centre);
  }
  c.fx = c.fy = c.focal_mm * std::max(c.width, c.height) / c.sensor_mm;
  c.cx = 0.5 * c.width;
  c.cy = 0.5 * c.height;
  return c;
}

inline dvec3 tiny_to_camera(const CameraRecord& c, const dvec3& p) {
  const auto& m = c.world_to_camera;
  const auto row = [&](int r) { return m[4 * r] * p.x + m[4 * r + 1] * p.y + m[4 * r + 2] * p.z + m[4 * r + 3]; };
  return {row(0), row(1), row(2)};
}

struct TinyHit {
  double depth;  // metres, camera z
  dvec3 nnopcs;
};

// Through a pixel position; pixel (i, j) has its centre at (i + 0.5, j + 0.5).
inline std::optional<TinyHit> tiny_trace(const TinyPose& pose, const CameraRecord& c, double x, double y) {
  const auto axis = [&](int r) {
    return dvec3(c.world_to_camera[4 * r], c.world_to_camera[4 * r + 1], c.world_to_camera[4 * r + 2]);
  };
  const dvec3 direction = (x - c.cx) / c.fx * axis(0) + (y - c.cy) / c.fy * axis(1) + axis(2);  // camera z is 1
  const dvec3 o = tiny_sphere_point(pose, c.centre), d = glm::inverse(pose.to_world) * direction;
  const double a = glm::dot(d, d), b = glm::dot(o, d), q = b * b - a * (glm::dot(o, o) - 1);
  if (q < 0) return {};
  const double t = (-b - std::sqrt(q)) / a;
  return TinyHit{t, 0.5 + 0.5 * (o + t * d)};
}

// sRGB in [0, 1]: smooth, so that JPEG hardly changes it.
inline dvec3 tiny_color(int coat, const dvec3& nnopcs) {
  const dvec3 base[3] = {{0.75, 0.4, 0.3}, {0.3, 0.6, 0.4}, {0.4, 0.4, 0.7}};
  return base[coat % 3] + 0.2 * (nnopcs - 0.5);
}

inline constexpr double tiny_background = 0.45;  // sRGB, close to the coats

inline double linear_of_srgb(double v) {
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

inline Manifest tiny_manifest(const TinyOptions& o) {
  Manifest m;
  m.species = o.species;
  m.seed = o.seed;
  m.scene = {{"about", "an ellipsoid"}};
  for (int f = 1; f <= o.frames; ++f) m.frames.push_back(f);
  for (int c = 0; c < 8 * o.rings; ++c) m.cameras.push_back(tiny_camera(c, o));
  for (int coat = 0; coat < o.coats; ++coat) {
    m.coats.push_back(fmt::format("coat_{}", coat));
    m.coat_indices.push_back(coat);
  }
  m.animals = {o.species};
  for (std::size_t k = 0; k < tiny_keypoints(tiny_pose(1)).size(); ++k) {
    m.keypoint_names.push_back(fmt::format("point_{}", k));
    m.keypoint_tolerance.push_back(0.02);
  }
  m.skeleton = {{0, 1}, {0, 2}, {0, 3}, {0, 4}, {0, 5}, {0, 6}};
  for (Modality modality : {Modality::rgb, Modality::silhouette, Modality::depth, Modality::keypoints})
    if (modality != Modality::rgb || o.coats > 0) m.modalities.add(modality);
  if (o.nnopcs) m.modalities.add(Modality::nnopcs);
  m.nnopcs_lower = {-0.45, -0.22, -0.3};
  m.nnopcs_upper = {0.45, 0.22, 0.3};
  return m;
}

inline View tiny_view(const TinyOptions& o, int frame, int camera) {
  const TinyPose pose = tiny_pose(frame, o.seed);
  const CameraRecord c = tiny_camera(camera, o);
  View view;
  view.frame = frame;
  view.camera = camera;
  view.width = o.width;
  view.height = o.height;
  view.background = vec3(static_cast<float>(linear_of_srgb(tiny_background)));
  Map silhouette{.modality = Modality::silhouette, .u = ImageU32(o.width, o.height, 1)};
  Map depth{.modality = Modality::depth, .f = ImageF(o.width, o.height, 1)};
  Map nnopcs{.modality = Modality::nnopcs, .f = ImageF(o.width, o.height, 3)};
  std::vector<Map> colors;
  for (int coat = 0; coat < o.coats; ++coat)
    colors.push_back({.modality = Modality::rgb, .coat = coat, .f = ImageF(o.width, o.height, 4)});
  for (int y = 0; y < o.height; ++y)
    for (int x = 0; x < o.width; ++x) {
      const std::optional<TinyHit> hit = tiny_trace(pose, c, x + 0.5, y + 0.5);
      if (!hit) continue;
      silhouette.u.at(x, y) = 255;
      depth.f.at(x, y) = static_cast<float>(hit->depth);
      for (int k = 0; k < 3; ++k) {
        nnopcs.f.at(x, y, k) = static_cast<float>(std::clamp(hit->nnopcs[k], 0.0, 1.0));
        for (int coat = 0; coat < o.coats; ++coat)
          colors[coat].f.at(x, y, k) = static_cast<float>(linear_of_srgb(tiny_color(coat, hit->nnopcs)[k]));
      }
      for (Map& color : colors) color.f.at(x, y, 3) = 1;
    }
  view.maps = {silhouette, depth};
  if (o.nnopcs) view.maps.push_back(nnopcs);
  for (Map& color : colors) view.maps.push_back(std::move(color));
  view.keypoints.resize(1);
  for (const dvec3& p : tiny_keypoints(pose)) {
    const dvec3 q = tiny_to_camera(c, p);
    view.keypoints[0].push_back(
        {{c.fx * q.x / q.z + c.cx, c.fy * q.y / q.z + c.cy}, q.z, Visibility::visible, HiddenBy::nothing, -1, 0});
  }
  if (o.edit) o.edit(view);
  return view;
}

inline void write_tiny_dataset(const fs::path& folder, const TinyOptions& o = {}) {
  const Manifest m = tiny_manifest(o);
  DatasetWriter writer(folder, m, 1);
  for (int frame : m.frames) {
    FrameRecord record;
    record.frame = frame;
    record.keypoints = {tiny_keypoints(tiny_pose(frame, o.seed))};
    record.placement = {dmat4(1.0)};
    for (const CameraRecord& c : m.cameras) writer.write_view(tiny_view(o, frame, c.id));
    writer.finish_frame(record);
  }
  writer.finish();
}

}  // namespace moomill::test
