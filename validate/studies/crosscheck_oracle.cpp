// Labels of the cross-check against double precision.
#include "generator/core/error.h"
#include "validate/studies/crosscheck.h"

namespace moomill {

namespace {

constexpr int tile = 16;  // pixels

// A vector of the world in the camera's axes.
dvec3 turned(const CameraRecord& camera, const dvec3& v) {
  const auto& m = camera.world_to_camera;
  dvec3 out;
  for (int r = 0; r < 3; ++r) out[r] = m[4 * r] * v.x + m[4 * r + 1] * v.y + m[4 * r + 2] * v.z;
  return out;
}

}  // namespace

ExactView::ExactView(const Scene& scene, const CameraRecord& camera) : camera_(camera) {
  tiles_x_ = (camera.width + tile - 1) / tile, tiles_y_ = (camera.height + tile - 1) / tile;
  tiles_.resize(static_cast<std::size_t>(tiles_x_) * tiles_y_);
  const dvec3 shift(camera.world_to_camera[3], camera.world_to_camera[7], camera.world_to_camera[11]);
  for (const Instance& in : scene.instances) {
    std::vector<dvec3> p;
    for (const vec3& v : in.posed.positions) p.push_back(turned(camera, dvec3(v) + scene.origin) + shift);
    for (std::size_t i = 0; i < in.surface->triangles.size(); ++i) {
      const uvec3 t = in.surface->triangles[i];
      const Triangle e{p[t[0]], p[t[1]], p[t[2]], &in, static_cast<std::uint32_t>(i)};
      if (e.a.z <= 0 && e.b.z <= 0 && e.c.z <= 0) continue;
      dvec2 lower(0),
          upper(camera.width, camera.height);  // pixels; all of the picture where a corner is behind the eye
      if (e.a.z > 0 && e.b.z > 0 && e.c.z > 0) {
        const auto pixel = [&](const dvec3& q) {
          return dvec2(camera.fx * q.x / q.z + camera.cx, camera.fy * q.y / q.z + camera.cy);
        };
        const dvec2 a = pixel(e.a), b = pixel(e.b), c = pixel(e.c);
        lower = glm::max(lower, glm::min(a, glm::min(b, c)) - 1e-3),
        upper = glm::min(upper, glm::max(a, glm::max(b, c)) + 1e-3);
      }
      const auto number = static_cast<std::uint32_t>(triangles_.size());
      triangles_.push_back(e);
      for (int y = static_cast<int>(lower.y) / tile; y < tiles_y_ && y * tile <= upper.y; ++y)
        for (int x = static_cast<int>(lower.x) / tile; x < tiles_x_ && x * tile <= upper.x; ++x)
          tiles_[static_cast<std::size_t>(y) * tiles_x_ + x].push_back(number);
    }
  }
}

ExactView::Hit ExactView::first_hit(int x, int y) const {
  // With a direction of z = 1 the distance along the ray is the depth.
  const dvec3 d((x + 0.5 - camera_.cx) / camera_.fx, (y + 0.5 - camera_.cy) / camera_.fy, 1.0);
  const Triangle* met = nullptr;
  dvec3 weights(0);
  Hit best;
  best.depth = std::numeric_limits<double>::infinity();
  for (const std::uint32_t i : tiles_[static_cast<std::size_t>(y / tile) * tiles_x_ + x / tile]) {
    const Triangle& e = triangles_[i];
    // Volumes of the tetrahedra that the ray's line and each edge span with the eye; their signs say inside or outside.
    const double a = glm::dot(d, glm::cross(e.b, e.c)), b = glm::dot(d, glm::cross(e.c, e.a)),
                 c = glm::dot(d, glm::cross(e.a, e.b));
    const double sum = a + b + c;
    if (sum == 0 || !((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0))) continue;
    const double depth = (a * e.a.z + b * e.b.z + c * e.c.z) / sum;
    if (!(depth > 0) || depth >= best.depth) continue;
    best.depth = depth;
    met = &e;
    weights = dvec3(a, b, c) / sum;
  }
  if (!met) return best;
  const Instance& in = *met->instance;
  const uvec3 t = in.surface->triangles[met->index];
  best.animal = static_cast<std::uint32_t>(in.animal + 1);
  best.eye = -glm::normalize(d);
  best.geometric = glm::normalize(glm::cross(met->b - met->a, met->c - met->a));
  if (glm::dot(best.geometric, best.eye) < 0) best.geometric = -best.geometric;
  for (int k = 0; k < 3; ++k) {
    if (!in.surface->nnopcs.empty()) best.nnopcs += weights[k] * dvec3(in.surface->nnopcs[t[k]]);
    best.normal += weights[k] * turned(camera_, dvec3(in.posed.normals[t[k]]));
  }
  best.normal = glm::length(best.normal) > 1e-6 ? glm::normalize(best.normal) : best.geometric;
  if (glm::dot(best.normal, best.geometric) < 0) best.normal = -best.normal;
  return best;
}

bool bent_by_cycles(const ExactView::Hit& hit) {
  const dvec3 mirrored = 2 * glm::dot(hit.normal, hit.eye) * hit.normal - hit.eye;
  return glm::dot(hit.geometric, mirrored) < std::min(0.9 * glm::dot(hit.geometric, hit.eye), 0.01);
}

std::vector<bool> bent_pixels(const ExactView& exact, int width, int height) {
  constexpr int reach = 2;  // pixels that the filter carries it to
  std::vector<bool> out(static_cast<std::size_t>(width) * height, false);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const ExactView::Hit hit = exact.first_hit(x, y);
      if (!std::isfinite(hit.depth) || !bent_by_cycles(hit)) continue;
      for (int j = std::max(0, y - reach); j <= std::min(height - 1, y + reach); ++j)
        for (int i = std::max(0, x - reach); i <= std::min(width - 1, x + reach); ++i)
          out[static_cast<std::size_t>(j) * width + i] = true;
    }
  return out;
}

LabelJudgement judge_labels(const LabelMaps& ours, const LabelMaps& theirs, const ExactView& exact, int others) {
  check(ours.width == theirs.width && ours.height == theirs.height, "judged labels have one size");
  LabelJudgement j;
  const auto nnopcs_error = [](const float* value, const dvec3& truth) {
    double worst = 0;
    for (int k = 0; k < 3; ++k)
      worst = std::isnan(value[k]) ? std::numeric_limits<double>::infinity()
                                   : std::max(worst, std::abs(value[k] - truth[k]));
    return worst;
  };
  std::uint64_t both = 0;
  for (std::size_t p = 0; p < ours.animal.size(); ++p)
    both += ours.animal[p] != 0 && ours.animal[p] == theirs.animal[p];
  const std::uint64_t step = std::max<std::uint64_t>(1, both / std::max(1, others));
  std::uint64_t n = 0;
  for (std::size_t p = 0; p < ours.animal.size(); ++p) {
    if (ours.animal[p] == 0 || ours.animal[p] != theirs.animal[p]) continue;
    const float *a = &ours.nnopcs[3 * p], *b = &theirs.nnopcs[3 * p];
    const bool off = !(std::abs(double(ours.depth[p]) - theirs.depth[p]) <= label_tolerance) ||
                     !(nnopcs_error(b, dvec3(a[0], a[1], a[2])) <= label_tolerance);
    if (n++ % step != 0 && !off) continue;
    const ExactView::Hit truth = exact.first_hit(static_cast<int>(p % ours.width), static_cast<int>(p / ours.width));
    const auto depth_error = [&](float depth) {
      return std::isnan(depth) ? std::numeric_limits<double>::infinity() : std::abs(depth - truth.depth);
    };
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
