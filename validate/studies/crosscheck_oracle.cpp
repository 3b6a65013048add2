// Labels of the cross-check against double precision.
#include "generator/core/error.h"
#include "validate/studies/crosscheck.h"

namespace moomill {

ExactView::ExactView(const Scene& scene, const CameraRecord& camera) : fx_(camera.fx), fy_(camera.fy), cx_(camera.cx), cy_(camera.cy) {
  const auto& m = camera.world_to_camera;
  for (const Instance& in : scene.instances) {
    const Surface& s = *in.surface;
    std::vector<dvec3> p;
    for (const vec3& v : in.posed.positions) {
      const dvec3 w = dvec3(v) + scene.origin;
      dvec3 c;
      for (int r = 0; r < 3; ++r) c[r] = m[4 * r] * w.x + m[4 * r + 1] * w.y + m[4 * r + 2] * w.z + m[4 * r + 3];
      p.push_back(c);
    }
    for (const uvec3& t : s.triangles) {
      Triangle e{p[t[0]], p[t[1]], p[t[2]], {}, {}, {}, {}, {}, static_cast<std::uint32_t>(in.animal + 1)};
      if (e.a.z <= 0 && e.b.z <= 0 && e.c.z <= 0) continue;
      constexpr double all = std::numeric_limits<double>::infinity();
      e.lower = dvec2(-all), e.upper = dvec2(all);
      if (e.a.z > 0 && e.b.z > 0 && e.c.z > 0) {
        const dvec2 a = dvec2(e.a) / e.a.z, b = dvec2(e.b) / e.b.z, c = dvec2(e.c) / e.c.z;
        e.lower = glm::min(a, glm::min(b, c)), e.upper = glm::max(a, glm::max(b, c));
      }
      if (!s.nnopcs.empty()) e.nnopcs_a = s.nnopcs[t[0]], e.nnopcs_b = s.nnopcs[t[1]], e.nnopcs_c = s.nnopcs[t[2]];
      triangles_.push_back(e);
    }
  }
}

ExactView::Hit ExactView::first_hit(int x, int y) const {
  // With a direction of z = 1 the distance along the ray is the depth.
  const dvec3 d((x + 0.5 - cx_) / fx_, (y + 0.5 - cy_) / fy_, 1.0);
  Hit best;
  best.depth = std::numeric_limits<double>::infinity();
  for (const Triangle& e : triangles_) {
    if (d.x < e.lower.x || d.y < e.lower.y || d.x > e.upper.x || d.y > e.upper.y) continue;
    // Volumes of the tetrahedra that the ray's line and each edge span with the eye; their signs say inside or outside.
    const double a = glm::dot(d, glm::cross(e.b, e.c)), b = glm::dot(d, glm::cross(e.c, e.a)), c = glm::dot(d, glm::cross(e.a, e.b));
    const double sum = a + b + c;
    if (sum == 0 || !((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0))) continue;
    const double depth = (a * e.a.z + b * e.b.z + c * e.c.z) / sum;
    if (!(depth > 0) || depth >= best.depth) continue;
    best = {e.animal, depth, (a * e.nnopcs_a + b * e.nnopcs_b + c * e.nnopcs_c) / sum};
  }
  return best;
}

LabelJudgement judge_labels(const LabelMaps& ours, const LabelMaps& theirs, const ExactView& exact, int others) {
  check(ours.width == theirs.width && ours.height == theirs.height, "judged labels have one size");
  LabelJudgement j;
  const auto nnopcs_error = [](const float* value, const dvec3& truth) {
    double worst = 0;
    for (int k = 0; k < 3; ++k) worst = std::isnan(value[k]) ? std::numeric_limits<double>::infinity() : std::max(worst, std::abs(value[k] - truth[k]));
    return worst;
  };
  std::uint64_t both = 0;
  for (std::size_t p = 0; p < ours.animal.size(); ++p) both += ours.animal[p] != 0 && ours.animal[p] == theirs.animal[p];
  const std::uint64_t step = std::max<std::uint64_t>(1, both / std::max(1, others));
  std::uint64_t n = 0;
  for (std::size_t p = 0; p < ours.animal.size(); ++p) {
    if (ours.animal[p] == 0 || ours.animal[p] != theirs.animal[p]) continue;
    const float *a = &ours.nnopcs[3 * p], *b = &theirs.nnopcs[3 * p];
    const bool off = !(std::abs(double(ours.depth[p]) - theirs.depth[p]) <= label_tolerance) || !(nnopcs_error(b, dvec3(a[0], a[1], a[2])) <= label_tolerance);
    if (n++ % step != 0 && !off) continue;
    const ExactView::Hit truth = exact.first_hit(static_cast<int>(p % ours.width), static_cast<int>(p / ours.width));
    const auto depth_error = [&](float depth) { return std::isnan(depth) ? std::numeric_limits<double>::infinity() : std::abs(depth - truth.depth); };
    const double ours_depth = depth_error(ours.depth[p]), theirs_depth = depth_error(theirs.depth[p]);
    const double ours_nnopcs = nnopcs_error(a, truth.nnopcs), theirs_nnopcs = nnopcs_error(b, truth.nnopcs);
    ++j.judged;
    j.our_depth = std::max(j.our_depth, ours_depth), j.their_depth = std::max(j.their_depth, theirs_depth);
    j.our_nnopcs = std::max(j.our_nnopcs, ours_nnopcs), j.their_nnopcs = std::max(j.their_nnopcs, theirs_nnopcs);
    if (!off) continue;
    ++j.off;
    j.off_ours_right += ours_depth <= label_tolerance && ours_nnopcs <= label_tolerance;
    j.off_theirs_right += theirs_depth <= label_tolerance && theirs_nnopcs <= label_tolerance;
  }
  return j;
}

}  // namespace moomill
