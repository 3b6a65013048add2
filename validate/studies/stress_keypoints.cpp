// Stress cases of keypoints: where they are seen, and whether, at the borders of every decision.
#include "generator/render/labels.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

// A camera at (0, 0, 8) that looks down: x of the picture is +x, y is -y, and a metre at z = 0 is 8 pixels of 64. All
// of its numbers are powers of two, so that borders are met exactly.
Camera exact_camera() {
  Camera c;
  c.world_to_camera = dmat3(dvec3(1, 0, 0), dvec3(0, -1, 0), dvec3(0, 0, -1));
  c.centre = {0, 0, 8};
  c.fx = c.fy = 64;
  c.cx = c.cy = 32;
  c.width = c.height = 64;
  return c;
}

Stage ball_stage() {
  Stage stage;
  stage.add(stress_sphere(24, 48, 1, 3));
  return stage;
}

double behind(const StressOptions&) {
  const Stage stage = ball_stage();
  const Accel accel(stage.scene);
  const Camera camera = exact_camera();
  double wrong = 0;
  for (const dvec3& p : {dvec3(0, 0, 9), dvec3(0, 0, 8), dvec3(1, 2, 8), dvec3(0, 0, 8 + 1e-15), dvec3(1e300, 0, 8),
                         dvec3(0, 0, 1e300)}) {
    const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {p, 0.02});
    wrong += k.visibility != Visibility::off_frame || k.cause != HiddenBy::off_frame || !(k.depth <= 0) ||
             !all_finite(k.pixel);
  }
  return wrong;
}

// A hair in front of the camera's plane: pixels beyond all pictures, without overflow anywhere.
double camera_plane(const StressOptions&) {
  const Stage stage = ball_stage();
  const Accel accel(stage.scene);
  const Camera camera = exact_camera();
  double wrong = 0;
  for (const double z : {1e-9, 1e-15, 0.0})
    for (const double x : {0.0, 1.0, -1e6}) {
      const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {{x, 0, 8 - z}, 0.02});
      wrong += std::isnan(k.pixel.x) || std::isnan(k.pixel.y) || std::isnan(k.margin) ||
               (x != 0 && k.visibility != Visibility::off_frame);
    }
  return wrong;
}

// Keypoints whose pixel is a border, or the double next to it: [0, 64) belongs to the picture.
double border(const StressOptions&) {
  const Stage stage = ball_stage();
  const Accel accel(stage.scene);
  const Camera camera = exact_camera();
  double wrong = 0;
  for (const double pixel : {0.0, 64.0, -0x1p-40, 64 - 0x1p-40, 32.0})
    for (const bool vertical : {false, true}) {
      const double metres = (pixel - 32) / 8;  // exact
      const dvec3 p = vertical ? dvec3(0, -metres, 0) : dvec3(metres, 0, 0);
      const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {p, 4});
      const bool inside = pixel >= 0 && pixel < 64;
      const double got = vertical ? k.pixel.y : k.pixel.x;
      wrong += got != pixel || (k.visibility != Visibility::off_frame) != inside;
    }
  return wrong;
}

// Points exactly on the outline of a plate: its corners and the middles of its borders. Nothing is in front of them.
double silhouette(const StressOptions&) {
  Stage stage;
  stage.add(stress_plate({-1, -1, 0}, {2, 0, 0}, {0, 2, 0}, 2));
  const Accel accel(stage.scene);
  double wrong = 0;
  for (const dvec3& eye : {dvec3(0, 0, 8), dvec3(3, 1, 5), dvec3(-2, 7, 0.1)}) {
    const Camera camera = stress_camera(eye, {0, 0, 0}, 60, 640, 480);
    for (int x = -1; x <= 1; ++x)
      for (int y = -1; y <= 1; ++y) {
        const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {{x, y, 0}, 0});
        wrong += k.visibility != Visibility::visible || k.cause != HiddenBy::nothing || !(std::abs(k.margin) < 1e-9);
      }
  }
  return wrong;
}

// Vertices of a ball at its silhouette, seen from cameras whose ray touches it there: nothing is in front of them, so
// they are visible at a tolerance that bridges the chord of the faces; and the answer is finite.
double tangent(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(32, 64, 1));
  const Accel accel(stage.scene);
  const Surface& s = *stage.surfaces[0];
  double wrong = 0;
  for (std::size_t v = 2; v < s.rest.size(); v += 5) {
    const dvec3 p(s.rest[v]), n = glm::normalize(p);
    dvec3 along = glm::cross(n, std::abs(n.z) < 0.9 ? dvec3(0, 0, 1) : dvec3(1, 0, 0));
    along = glm::normalize(along);
    const Camera camera = stress_camera(p + 5.0 * along, p, 30, 640, 480);
    const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {p, 0.11});
    wrong += k.visibility != Visibility::visible || !std::isfinite(k.margin);
  }
  return wrong;
}

// Points of the surface that face the camera, with no tolerance at all: each is visible, its margin is rounding.
double on_surface(double far) {
  Stage stage;
  stage.scene.origin = dvec3(far, -far, 0.5 * far);
  stage.add(stress_sphere(24, 48, 1));
  const Accel accel(stage.scene);
  const Camera camera = stress_camera(stage.scene.origin + dvec3(6, 2, 1), stage.scene.origin, 40, 640, 480);
  const Surface& s = *stage.surfaces[0];
  double wrong = 0;
  for (const uvec3& t : s.triangles) {
    const dvec3 a(s.rest[t[0]]), b(s.rest[t[1]]), c(s.rest[t[2]]);
    for (const dvec3& weights : {dvec3(1.0 / 3), dvec3(0.2, 0.3, 0.5), dvec3(0.7, 0.29, 0.01)}) {
      const dvec3 p = stage.scene.origin + weights.x * a + weights.y * b + weights.z * c;
      if (glm::dot(glm::normalize(glm::cross(b - a, c - a)), glm::normalize(camera.centre - p)) < 0.05) continue;
      const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {p, 0});
      wrong += k.visibility != Visibility::visible;
    }
  }
  return wrong;
}

// Two keypoints in one place, and the same place asked of two coincident animals: the same pixel, margin and answer.
double coincident(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(24, 48, 1, 3), 0);
  stage.add(stress_sphere(24, 48, 1, 3), 1);
  const Accel accel(stage.scene);
  const Camera camera = stress_camera({5, 1, 2}, {0, 0, 0}, 40, 640, 480);
  const Surface& s = *stage.surfaces[0];
  double wrong = 0;
  for (std::size_t v = 0; v < s.rest.size(); v += 3) {
    const dvec3 p(s.rest[v]);
    const KeypointView a = trace_keypoint(stage.scene, accel, camera, 0, {p, 0.01}),
                       b = trace_keypoint(stage.scene, accel, camera, 0, {p, 0.01}),
                       c = trace_keypoint(stage.scene, accel, camera, 1, {p, 0.01});
    wrong += a.visibility != b.visibility || a.margin != b.margin || a.pixel != b.pixel || a.depth != b.depth;
    wrong += a.margin != c.margin || a.pixel != c.pixel;
    // Where nothing is before the point but the two surfaces it lies on, neither animal hides it from the other.
    if (a.margin < 1e-9) wrong += a.visibility != Visibility::visible || c.visibility != Visibility::visible;
  }
  return wrong;
}

// Depth behind the surface against the analytic distance: a keypoint in the middle of a box seen along its axis.
double margin_error(double far) {
  Stage stage;
  stage.scene.origin = dvec3(far, -far, 0.5 * far);
  stage.add(stress_plate({-1, -1, 0.5f}, {2, 0, 0}, {0, 2, 0}, 7));
  const Accel accel(stage.scene);
  double worst = 0;
  for (int i = 0; i < 50; ++i) {
    const dvec3 eye(0.3 * i - 7, 2, 6), p(0.01 * i, -0.3, -0.25);
    Camera camera = stress_camera(eye, {0, 0, 0}, 60, 640, 480);
    camera.centre += stage.scene.origin;
    const KeypointView k = trace_keypoint(stage.scene, accel, camera, 0, {stage.scene.origin + p, 0.02});
    const double whole = glm::length(p - eye), to_plate = whole * (6 - 0.5) / (6 + 0.25);  // similar triangles
    const dvec3 at = eye + (p - eye) * (5.5 / 6.25);
    if (std::max(std::abs(at.x), std::abs(at.y)) > 0.999) continue;
    worst = std::max(worst, std::abs(k.margin - (whole - to_plate)));
    if (k.visibility != Visibility::hidden || k.cause != HiddenBy::self) return 1;
  }
  return worst;
}

double at_tolerance(const StressOptions&) {
  Stage stage;
  stage.add(stress_plate({-1, -1, 0.25f}, {2, 0, 0}, {0, 2, 0}, 2));
  const Accel accel(stage.scene);
  const Camera camera = exact_camera();
  double wrong = 0;
  // Straight below the camera all numbers are exact: the point lies exactly 0.25 m behind the plate.
  for (const auto& [tolerance, visible] : {std::pair(0.25, true), std::pair(0.2499, false), std::pair(0.2501, true)}) {
    const KeypointView k =
        trace_keypoint(stage.scene, accel, camera, 0,
                       {{0.125, 0.0625, 0}, tolerance * std::sqrt(1 + 0.125 * 0.125 / 64 + 0.0625 * 0.0625 / 64)});
    wrong += (k.visibility == Visibility::visible) != visible;
  }
  return wrong;
}

double not_a_number(const StressOptions&) {
  const Stage stage = ball_stage();
  const Accel accel(stage.scene);
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  double wrong = 0;
  for (const dvec3& p : {dvec3(nan), dvec3(nan, 0, 0), dvec3(0, 0, nan), dvec3(infinity, 0, 0), dvec3(0, 0, -infinity),
                         dvec3(1e308, 1e308, -1e308)})
    wrong += trace_keypoint(stage.scene, accel, exact_camera(), 0, {p, 0.02}).visibility != Visibility::off_frame;
  return wrong;
}

}  // namespace

std::vector<StressCase> keypoint_stress() {
  constexpr Oracle analytic = Oracle::analytic, predicate = Oracle::exact_predicate;
  return {
      {"behind the camera", "behind it, in its plane and at its centre", predicate, 0, "keypoints",
       "each is off the picture, with a depth of 0 or less and finite pixels", behind},
      {"a hair before the camera's plane", "1e-9 and 1e-15 m before it, up to 1e6 m aside", predicate, 0, "keypoints",
       "no value is not-a-number, and what is aside is off the picture", camera_plane},
      {"on the border of the picture", "pixel 0, 64, and 1e-12 beside them, both axes", predicate, 0, "keypoints",
       "[0, width) is inside: the first border belongs to the picture, the last does not", border},
      {"exactly on a silhouette", "corners and borders of a plate, no tolerance", predicate, 0, "keypoints",
       "nothing is in front of them, so each is visible with a margin below 1e-9 m", silhouette},
      {"touched by a tangent ray", "vertices of a ball that the ray grazes", predicate, 0, "keypoints",
       "the faces' chord is at most 0.1 m, and the tolerance 0.11 m: each is visible", tangent},
      {"on the surface, no tolerance", "points of faces towards the camera", predicate, 0, "keypoints",
       "nothing is in front of them but rounding", [](const StressOptions&) { return on_surface(0); }},
      {"on the surface, 1e6 m away", "the same, 1e6 m from the origin", predicate, 0, "keypoints",
       "nothing is in front of them but rounding", [](const StressOptions&) { return on_surface(1e6); }},
      {"coincident keypoints", "two in one place, and the same place on two coincident animals", predicate, 0,
       "keypoints", "the same pixel and margin; a surface in the same place hides nothing", coincident},
      {"margin behind a plate", "0.75 m below a plate, from 50 cameras", analytic, 1e-12, "m",
       "similar triangles in double, at 10 m: a thousand roundings",
       [](const StressOptions&) { return margin_error(0); }},
      {"margin behind a plate, 1e6 m away", "the same, 1e6 m from the origin", analytic, 2e-9, "m",
       "camera and keypoint are rounded to 1.2e-10 m on each axis there",
       [](const StressOptions&) { return margin_error(1e6); }},
      {"at the tolerance", "exactly 0.25 m behind a plate, tolerances around it", predicate, 0, "keypoints",
       "visible up to the tolerance, hidden beyond", at_tolerance},
      {"keypoints that are not finite", "not-a-number, infinite, overflowing", predicate, 0, "keypoints",
       "none of them is seen", not_a_number},
  };
}

}  // namespace moomill
