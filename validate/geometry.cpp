#include "validate/geometry.h"

namespace moomill {

dvec3 Pinhole::to_camera(const dvec3& world) const {
  const dvec3 d = world - centre;
  return {glm::dot(axes[0], d), glm::dot(axes[1], d), glm::dot(axes[2], d)};
}

std::optional<dvec2> Pinhole::pixel(const dvec3& world) const {
  const dvec3 p = to_camera(world);
  if (!(p.z > 0)) return std::nullopt;
  return dvec2(cx + fx * p.x / p.z, cy + fy * p.y / p.z);
}

dvec3 Pinhole::world(double x, double y, double depth) const {
  return centre + depth * ((x - cx) / fx * axes[0] + (y - cy) / fy * axes[1] + axes[2]);
}

Pinhole pinhole_from_euler(const dvec3& centre, const dvec3& euler, double focal_mm, double sensor_mm, int width,
                           int height) {
  // Turned about X first, then Y, then Z, all world axes.
  const auto turned = [&](dvec3 v) {
    const auto turn = [](double& a, double& b, double angle) {
      const double c = std::cos(angle), s = std::sin(angle), a0 = a;
      a = c * a0 - s * b;
      b = s * a0 + c * b;
    };
    turn(v.y, v.z, euler.x);
    turn(v.z, v.x, euler.y);
    turn(v.x, v.y, euler.z);
    return v;
  };
  Pinhole p;
  p.axes = {turned({1, 0, 0}), turned({0, -1, 0}), turned({0, 0, -1})};
  p.centre = centre;
  p.fx = p.fy = focal_mm / sensor_mm * std::max(width, height);
  p.cx = width / 2.0;
  p.cy = height / 2.0;
  return p;
}

Pinhole pinhole_from_matrix(const CameraRecord& c) {
  Pinhole p;
  const auto& m = c.world_to_camera;
  for (int r = 0; r < 3; ++r) p.axes[r] = {m[4 * r], m[4 * r + 1], m[4 * r + 2]};
  p.centre = -(m[3] * p.axes[0] + m[7] * p.axes[1] + m[11] * p.axes[2]);
  p.fx = c.fx;
  p.fy = c.fy;
  p.cx = c.cx;
  p.cy = c.cy;
  return p;
}

double pinhole_difference(const Pinhole& a, const Pinhole& b, int width, int height, double distance) {
  double worst = 0;
  for (double x : {0.0, double(width)})
    for (double y : {0.0, double(height)}) {
      const std::optional<dvec2> other = b.pixel(a.world(x, y, distance));
      if (!other) return std::numeric_limits<double>::infinity();
      worst = std::max(worst, glm::distance(*other, dvec2(x, y)));
    }
  return worst;
}

namespace {

// Hamilton product of (x, y, z, w).
dvec4 product(const dvec4& a, const dvec4& b) {
  return {a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y, a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
          a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}

// Unit quaternion (x, y, z, w) of a rotation matrix, by its largest component.
dvec4 quaternion(const dmat4& m) {
  const double r[3][3] = {{m[0][0], m[1][0], m[2][0]}, {m[0][1], m[1][1], m[2][1]}, {m[0][2], m[1][2], m[2][2]}};
  const double squares[4] = {1 + r[0][0] - r[1][1] - r[2][2], 1 - r[0][0] + r[1][1] - r[2][2],
                             1 - r[0][0] - r[1][1] + r[2][2], 1 + r[0][0] + r[1][1] + r[2][2]};
  const int k = static_cast<int>(std::max_element(squares, squares + 4) - squares);
  dvec4 q;
  if (k == 3)
    q = {r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1], squares[3]};
  else if (k == 0)
    q = {squares[0], r[0][1] + r[1][0], r[0][2] + r[2][0], r[2][1] - r[1][2]};
  else if (k == 1)
    q = {r[0][1] + r[1][0], squares[1], r[1][2] + r[2][1], r[0][2] - r[2][0]};
  else
    q = {r[0][2] + r[2][0], r[1][2] + r[2][1], squares[2], r[1][0] - r[0][1]};
  return q / glm::length(q);
}

bool is_rigid(const dmat4& m) {
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      if (std::abs(glm::dot(dvec3(m[a]), dvec3(m[b])) - (a == b ? 1.0 : 0.0)) > 1e-6) return false;
  return glm::determinant(glm::dmat3(m)) > 0;
}

}  // namespace

std::optional<std::vector<dvec3>> skinned(const Rig& rig, const std::vector<dmat4>& bones,
                                          const std::vector<double>& morph_weights, bool dual_quaternion) {
  std::vector<dvec3> rest(rig.surface.rest.begin(), rig.surface.rest.end());
  for (const MorphTarget& morph : rig.morphs) {
    const std::vector<double>& weights = morph_weights.empty() ? rig.morph_weights : morph_weights;
    const auto slot = static_cast<std::size_t>(morph.weight_slot);
    if (slot >= weights.size() || weights[slot] == 0) continue;
    for (std::size_t i = 0; i < morph.positions.size() && morph.first_vertex + i < rest.size(); ++i)
      rest[morph.first_vertex + i] += weights[slot] * dvec3(morph.positions[i]);
  }
  std::vector<dvec4> real, dual;
  if (dual_quaternion) {
    for (const dmat4& m : bones) {
      if (!is_rigid(m)) return std::nullopt;
      real.push_back(quaternion(m));
      dual.push_back(0.5 * product(dvec4(dvec3(m[3]), 0), real.back()));
    }
  }
  if (rig.influence_begin.size() != rest.size() + 1) return std::nullopt;
  std::vector<dvec3> out(rest.size());
  for (std::size_t v = 0; v < rest.size(); ++v) {
    const Influence* first = rig.influences.data() + rig.influence_begin[v];
    const Influence* last = rig.influences.data() + rig.influence_begin[v + 1];
    for (const Influence* i = first; i != last; ++i)
      if (i->bone >= bones.size()) return std::nullopt;
    if (!dual_quaternion) {
      dvec3 sum(0);
      double total = 0;
      for (const Influence* i = first; i != last; ++i) {
        const dmat4& m = bones[i->bone];
        total += i->weight;
        for (int r = 0; r < 3; ++r)
          sum[r] += i->weight * (m[0][r] * rest[v].x + m[1][r] * rest[v].y + m[2][r] * rest[v].z + m[3][r]);
      }
      out[v] = total > 0 ? sum / total : rest[v];
      continue;
    }
    const Influence* heaviest =
        std::max_element(first, last, [](const Influence& a, const Influence& b) { return a.weight < b.weight; });
    dvec4 q(0), e(0);
    for (const Influence* i = first; i != last; ++i) {
      const double sign = glm::dot(real[i->bone], real[heaviest->bone]) < 0 ? -1.0 : 1.0;
      q += sign * i->weight * real[i->bone];
      e += sign * i->weight * dual[i->bone];
    }
    const double length = glm::length(q);
    q /= length;
    e /= length;
    const dvec4 conjugate(-q.x, -q.y, -q.z, q.w);
    const dvec3 turned(product(product(q, dvec4(rest[v], 0)), conjugate));
    out[v] = turned + 2.0 * dvec3(product(e, conjugate));
  }
  return out;
}

dvec3 at(const std::vector<dvec3>& vertices, const uvec3& t, const MeshPoint& p) {
  return (1 - p.u - p.v) * vertices[t[0]] + p.u * vertices[t[1]] + p.v * vertices[t[2]];
}

namespace {

// The point of a triangle closest to p, as barycentrics. The plane's foot where it falls inside, else on an edge.
MeshPoint closest(const dvec3& p, const dvec3& a, const dvec3& b, const dvec3& c) {
  const dvec3 ab = b - a, ac = c - a, ap = p - a;
  const double bb = glm::dot(ab, ab), bc = glm::dot(ab, ac), cc = glm::dot(ac, ac), pb = glm::dot(ap, ab),
               pc = glm::dot(ap, ac), det = bb * cc - bc * bc;
  if (det > 0) {
    const double u = (cc * pb - bc * pc) / det, v = (bb * pc - bc * pb) / det;
    if (u >= 0 && v >= 0 && u + v <= 1) return {0, u, v};
  }
  const auto along = [&](const dvec3& from, const dvec3& edge) {
    const double length2 = glm::dot(edge, edge);
    return length2 > 0 ? std::clamp(glm::dot(p - from, edge) / length2, 0.0, 1.0) : 0.0;
  };
  const double s = along(a, ab), t = along(a, ac), w = along(b, c - b);
  const MeshPoint candidates[3] = {{0, s, 0}, {0, 0, t}, {0, 1 - w, w}};
  const dvec3 points[3] = {a + s * ab, a + t * ac, b + w * (c - b)};
  int best = 0;
  for (int k = 1; k < 3; ++k)
    if (glm::distance(points[k], p) < glm::distance(points[best], p)) best = k;
  return candidates[best];
}

}  // namespace

TriangleGrid::TriangleGrid(std::vector<dvec3> vertices, std::vector<uvec3> triangles)
    : vertices_(std::move(vertices)), triangles_(std::move(triangles)) {
  for (const uvec3& t : triangles_)
    for (int k = 0; k < 3; ++k) box_.add(vertices_[t[k]]);
  if (box_.empty()) box_ = Box{dvec3(0), dvec3(1)};
  // About as many cells as twice the triangles, cubes as far as the box allows.
  const dvec3 extent = glm::max(box_.size(), dvec3(1e-9));
  const double edge =
      std::max(std::cbrt(extent.x * extent.y * extent.z / (2.0 * triangles_.size() + 1)), glm::length(extent) / 256);
  for (int k = 0; k < 3; ++k) {
    size_[k] = std::clamp(static_cast<int>(extent[k] / edge) + 1, 1, 256);
    step_[k] = extent[k] / size_[k];
  }
  const auto cells_of = [&](const uvec3& t, const auto& visit) {
    dvec3 lower = vertices_[t[0]], upper = lower;
    for (int k = 1; k < 3; ++k) lower = glm::min(lower, vertices_[t[k]]), upper = glm::max(upper, vertices_[t[k]]);
    const auto from = cell(lower), to = cell(upper);
    for (int z = from[2]; z <= to[2]; ++z)
      for (int y = from[1]; y <= to[1]; ++y)
        for (int x = from[0]; x <= to[0]; ++x) visit((static_cast<std::size_t>(z) * size_[1] + y) * size_[0] + x);
  };
  begin_.assign(static_cast<std::size_t>(size_[0]) * size_[1] * size_[2] + 1, 0);
  for (const uvec3& t : triangles_) cells_of(t, [&](std::size_t c) { ++begin_[c + 1]; });
  for (std::size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
  items_.resize(begin_.back());
  std::vector<std::uint32_t> fill(begin_.begin(), begin_.end() - 1);
  for (std::uint32_t i = 0; i < triangles_.size(); ++i)
    cells_of(triangles_[i], [&](std::size_t c) { items_[fill[c]++] = i; });
}

std::array<int, 3> TriangleGrid::cell(const dvec3& p) const {
  std::array<int, 3> c{};
  for (int k = 0; k < 3; ++k)
    c[k] = static_cast<int>(std::clamp((p[k] - box_.lower[k]) / step_[k], 0.0, size_[k] - 1.0));
  return c;
}

std::vector<MeshPoint> TriangleGrid::near(const dvec3& p, double radius) const {
  std::vector<MeshPoint> out;
  const auto from = cell(p - radius), to = cell(p + radius);
  for (int z = from[2]; z <= to[2]; ++z)
    for (int y = from[1]; y <= to[1]; ++y)
      for (int x = from[0]; x <= to[0]; ++x) {
        const std::size_t c = (static_cast<std::size_t>(z) * size_[1] + y) * size_[0] + x;
        for (std::uint32_t i = begin_[c]; i < begin_[c + 1]; ++i) {
          const uvec3& t = triangles_[items_[i]];
          MeshPoint point = closest(p, vertices_[t[0]], vertices_[t[1]], vertices_[t[2]]);
          point.triangle = items_[i];
          if (glm::distance(at(vertices_, t, point), p) <= radius) out.push_back(point);
        }
      }
  return out;
}

}  // namespace moomill
