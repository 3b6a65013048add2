// Where the cameras of a frame stand.
#include <set>

#include "generator/core/error.h"
#include "scenes/scene.h"

namespace moomill {
namespace {

// The XYZ Euler angles of a Blender camera (looks along its -Z, +Y up) at `centre` that looks at `target` without
// roll: ry = 0. Turned by rx about X the camera looks along (0, sin rx, -cos rx); then by rz about Z.
dvec3 look_at(const dvec3& centre, const dvec3& target) {
  const dvec3 d = target - centre;
  const double horizontal = std::hypot(d.x, d.y);
  const double rx = std::atan2(horizontal, -d.z);
  // Straight above or below every rz will do: 0, so that the image's up is the world's +Y.
  const double rz = horizontal > 0 ? std::atan2(-d.x, d.y) : 0.0;
  return {rx, 0.0, rz};
}

// Everything of the record that follows from centre, Euler angles, lens and size. The matrix is made from the angles
// that are written down, so a reader who rebuilds it gets the same one.
void finish_camera(CameraRecord& c) {
  const double sx = std::sin(c.euler_xyz.x), cx = std::cos(c.euler_xyz.x);
  const double sz = std::sin(c.euler_xyz.z), cz = std::cos(c.euler_xyz.z);
  // Columns of Rz Rx: the camera's right, up and backward axes in the world. OpenCV's are right, down and forward.
  const dvec3 right{cz, sz, 0}, up{-sz * cx, cz * cx, sx}, backward{sz * sx, -cz * sx, cx};
  const dvec3 rows[3] = {right, -up, -backward};
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) c.world_to_camera[4 * r + k] = rows[r][k];
    c.world_to_camera[4 * r + 3] = -glm::dot(rows[r], c.centre);
  }
  c.fx = c.fy = c.focal_mm * std::max(c.width, c.height) / c.sensor_mm;
  c.cx = 0.5 * c.width;
  c.cy = 0.5 * c.height;
}

}  // namespace

CameraRecord make_camera(int id, const dvec3& centre, const dvec3& target, double focal_mm, double sensor_mm, int width,
                         int height) {
  if (!(glm::length(target - centre) > 1e-9))
    input_error("camera {} stands where it looks at, ({}, {}, {}); move its position or its target", id, centre.x,
                centre.y, centre.z);
  CameraRecord c;
  c.id = id;
  c.centre = centre;
  c.euler_xyz = look_at(centre, target);
  c.focal_mm = focal_mm;
  c.sensor_mm = sensor_mm;
  c.width = width;
  c.height = height;
  finish_camera(c);
  return c;
}

std::vector<CameraRecord> cameras_of_frame(const SceneSpec& scene, int frame) {
  const CameraSpec& spec = scene.cameras;
  const std::set<int> only(spec.only.begin(), spec.only.end());
  std::vector<CameraRecord> out;
  auto add = [&](int id, const dvec3& centre, const dvec3& target) {
    out.push_back(make_camera(id, centre, target, draw_number(spec.focal_mm, scene.seed, frame, id), spec.sensor_mm,
                              spec.width, spec.height));
  };
  auto wanted = [&](int id) { return only.empty() || only.count(id); };
  if (spec.rings) {
    const RingCameras& rings = *spec.rings;
    for (int ring = 0; ring < static_cast<int>(rings.heights.size()); ++ring)
      for (int azimuth = 0; azimuth < rings.count; ++azimuth) {
        const int id = ring * rings.count + azimuth;
        if (!wanted(id)) continue;
        const dvec3 target = draw_vector(spec.target, scene.seed, frame, id);
        const double radius = draw_number(rings.radius, scene.seed, frame, id);
        const double a = (rings.first_azimuth_deg + 360.0 * azimuth / rings.count) * degrees;
        add(id, target + dvec3(radius * std::cos(a), radius * std::sin(a), rings.heights[ring]), target);
      }
  }
  for (const ListedCamera& c : spec.list)
    if (wanted(c.id))
      add(c.id, draw_vector(c.position, scene.seed, frame, c.id),
          draw_vector(c.target ? *c.target : spec.target, scene.seed, frame, c.id));
  std::sort(out.begin(), out.end(), [](const CameraRecord& a, const CameraRecord& b) { return a.id < b.id; });
  return out;
}

bool cameras_vary(const SceneSpec& scene) {
  const CameraSpec& spec = scene.cameras;
  bool vary = !spec.target.is_constant() || !spec.focal_mm.is_constant();
  if (spec.rings) vary = vary || !spec.rings->radius.is_constant();
  for (const ListedCamera& c : spec.list)
    vary = vary || !c.position.is_constant() || (c.target && !c.target->is_constant());
  return vary;
}

}  // namespace moomill
