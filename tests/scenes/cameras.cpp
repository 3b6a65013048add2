#include <doctest/doctest.h>

#include "generator/core/error.h"
#include "generator/render/camera.h"
#include "scenes/scene.h"

using namespace moomill;

namespace {

SceneSpec default_scene() {
  SceneSpec s;
  RingCameras rings;
  const CameraFraming framing;
  rings.radius = constant_number(framing.radius);
  rings.heights = framing.heights;
  s.cameras.rings = rings;
  s.cameras.target = constant_vector(framing.target);
  s.cameras.focal_mm = constant_number(framing.focal_mm);
  return s;
}

dmat3 rotation_of(const CameraRecord& c) {  // world to camera; glm is column-major
  dmat3 m;
  for (int r = 0; r < 3; ++r)
    for (int k = 0; k < 3; ++k) m[k][r] = c.world_to_camera[4 * r + k];
  return m;
}

dvec3 translation_of(const CameraRecord& c) {
  return {c.world_to_camera[3], c.world_to_camera[7], c.world_to_camera[11]};
}

dmat3 about(int axis, double angle) {  // independent of camera_plan.cpp: a quaternion's matrix
  dvec3 a(0);
  a[axis] = 1;
  return glm::mat3_cast(glm::angleAxis(angle, a));
}

double largest(const dmat3& m) {
  double worst = 0;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) worst = std::max(worst, std::abs(m[c][r]));
  return worst;
}

}  // namespace

TEST_CASE("three rings of eight, ids ring * 8 + azimuth, all looking at the target") {
  const SceneSpec scene = default_scene();
  const std::vector<CameraRecord> cameras = cameras_of_frame(scene, 1);
  REQUIRE(cameras.size() == 24);
  for (int i = 0; i < 24; ++i) {
    const CameraRecord& c = cameras[i];
    CHECK(c.id == i);
    CHECK(c.euler_xyz.y == 0);
    CHECK(c.fx == doctest::Approx(100.0 * 1024 / 36));
    CHECK(c.cx == 512);
    CHECK(c.cy == 384);
    const Camera camera = Camera::from_matrix(c.world_to_camera, c.fx, c.fy, c.cx, c.cy, c.width, c.height);
    CHECK(glm::length(camera.centre - c.centre) < 1e-12);
    const dvec3 target = camera.to_camera({0, 0, 0.8});
    CHECK(target.z > 10);
    CHECK(glm::length(camera.project(target) - dvec2(512, 384)) < 1e-9);
    CHECK(camera.to_camera({0, 0, 1.8}).y < target.y);  // up in the world is up in the image
    CHECK(std::atan2(c.centre.y, c.centre.x) == doctest::Approx(std::remainder(45.0 * (i % 8), 360) * degrees));
    CHECK(c.centre.z == doctest::Approx(0.8 + scene.cameras.rings->heights[i / 8]));
  }
}

TEST_CASE("the matrix is that of the Blender Euler angles, by independent maths") {
  SceneSpec scene = default_scene();
  for (const CameraRecord& c : cameras_of_frame(scene, 1)) {
    const dmat3 camera_to_world = about(2, c.euler_xyz.z) * about(1, c.euler_xyz.y) * about(0, c.euler_xyz.x);
    const dmat3 blender_to_opencv(dvec3(1, 0, 0), dvec3(0, -1, 0), dvec3(0, 0, -1));
    const dmat3 expected = blender_to_opencv * glm::transpose(camera_to_world);
    CHECK(largest(rotation_of(c) - expected) < 1e-14);
    CHECK(glm::length(translation_of(c) + expected * c.centre) < 1e-12);
    CHECK(std::abs(glm::determinant(rotation_of(c)) - 1) < 1e-14);
  }
}

TEST_CASE("turning the world by 45 degrees about Z maps azimuth a to a + 1, to 1e-12") {
  const std::vector<CameraRecord> cameras = cameras_of_frame(default_scene(), 1);
  double worst = 0;
  const dmat3 turn = about(2, 45 * degrees);
  for (int i = 0; i < 24; ++i) {
    const CameraRecord& a = cameras[i];
    const CameraRecord& b = cameras[i / 8 * 8 + (i + 1) % 8];
    worst = std::max(worst, largest(rotation_of(b) * turn - rotation_of(a)));
    worst = std::max(worst, glm::length(translation_of(b) - translation_of(a)));
    worst = std::max(worst, glm::length(turn * a.centre - b.centre));
  }
  CHECK(worst < 1e-12);
}

TEST_CASE("cameras straight above and below their target work") {
  const CameraRecord above = make_camera(0, {1, 2, 10}, {1, 2, 0}, 50, 36, 100, 100);
  CHECK(above.euler_xyz == dvec3(0));
  const Camera down = Camera::from_matrix(above.world_to_camera, above.fx, above.fy, above.cx, above.cy, 100, 100);
  CHECK(glm::length(down.to_camera({1, 2, 0}) - dvec3(0, 0, 10)) < 1e-12);
  CHECK(glm::length(down.to_camera({1, 3, 0}) - dvec3(0, -1, 10)) < 1e-12);  // the image's up is +Y
  const CameraRecord below = make_camera(0, {0, 0, -5}, {0, 0, 0}, 50, 36, 100, 100);
  const Camera up = Camera::from_matrix(below.world_to_camera, below.fx, below.fy, below.cx, below.cy, 100, 100);
  CHECK(glm::length(up.to_camera({0, 0, 0}) - dvec3(0, 0, 5)) < 1e-12);
  CHECK_THROWS_AS(make_camera(3, {1, 1, 1}, {1, 1, 1}, 50, 36, 100, 100), InputError);
}

TEST_CASE("the default cameras frame a cow, with room for its swinging head and tail") {
  // 2.2 m x 0.7 m x 1.65 m, and 15 cm more at every side.
  Box box;
  box.add({-1.25, -0.5, -0.02});
  box.add({1.25, 0.5, 1.8});
  double slack = 1e9;
  for (const CameraRecord& c : cameras_of_frame(default_scene(), 1)) {
    const Camera camera = Camera::from_matrix(c.world_to_camera, c.fx, c.fy, c.cx, c.cy, c.width, c.height);
    for (int corner = 0; corner < 8; ++corner) {
      const dvec3 p{corner & 1 ? box.upper.x : box.lower.x, corner & 2 ? box.upper.y : box.lower.y,
                    corner & 4 ? box.upper.z : box.lower.z};
      const dvec2 pixel = camera.project(camera.to_camera(p));
      slack = std::min({slack, pixel.x, pixel.y, c.width - pixel.x, c.height - pixel.y});
    }
  }
  INFO("least distance from the image border in pixels: ", slack);
  CHECK(slack > 10);
}

TEST_CASE("cameras drawn per view differ from view to view and stay the same from call to call") {
  SceneSpec scene = default_scene();
  CHECK_FALSE(cameras_vary(scene));
  Distribution& radius = scene.cameras.rings->radius;
  radius.kind = Choice::Kind::uniform;
  radius.values = {{9}, {12}};
  radius.key = "cameras.rings.radius";
  radius.per_view = true;
  CHECK(cameras_vary(scene));
  const std::vector<CameraRecord> a = cameras_of_frame(scene, 1), b = cameras_of_frame(scene, 2);
  CHECK(a[0].centre.x != b[0].centre.x);
  CHECK(std::hypot(a[0].centre.x, a[0].centre.y) != std::hypot(a[1].centre.x, a[1].centre.y));
  scene.cameras.only = {5};
  const std::vector<CameraRecord> one = cameras_of_frame(scene, 1);
  REQUIRE(one.size() == 1);
  CHECK(one[0].centre == a[5].centre);  // a selection does not change what is drawn
}
