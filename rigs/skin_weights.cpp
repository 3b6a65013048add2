#include "rigs/skin_weights.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <queue>

#include "generator/core/error.h"
#include "generator/core/parallel.h"

namespace moomill {
namespace {

struct Arrival {
  double time;
  std::int32_t cell;
  bool operator>(const Arrival& o) const { return time != o.time ? time > o.time : cell > o.cell; }
};

// Upwind solution of |grad t| = slowness at a cell from the neighbours that are done (Sethian 1996). `grid` spacing.
double eikonal(std::array<double, 3> t, double step, double slowness) {
  std::sort(t.begin(), t.end());
  const double h = step * slowness;
  double best = t[0] + h;
  for (int count = 2; count <= 3; ++count) {
    if (!(best > t[count - 1])) break;
    double sum = 0, squares = 0;
    for (int i = 0; i < count; ++i) sum += t[i], squares += t[i] * t[i];
    const double under = sum * sum - count * (squares - h * h);
    if (under < 0) break;
    best = (sum + std::sqrt(under)) / count;
  }
  return best;
}

double distance_to(const BoneSegment& bone, const dvec3& p) {
  const dvec3 ab = bone.to - bone.from, ap = p - bone.from;
  const double square = glm::dot(ab, ab);
  const double t = square > 0 ? std::clamp(glm::dot(ap, ab) / square, 0.0, 1.0) : 0.0;
  return glm::length(ap - t * ab);
}

// Thickness handed on from thick to thin, falling by `slope` on the way: a dewlap or a fold moves with the bulk it sits on.
std::vector<double> bulk_thickness(const VoxelSolid& solid, double slope) {
  std::vector<double> bulk(solid.places.size(), 0.0);
  std::priority_queue<Arrival, std::vector<Arrival>, std::greater<>> queue;  // thickest first
  for (std::size_t i = 0; i < bulk.size(); ++i) queue.push({-solid.thickness[i], static_cast<std::int32_t>(i)});
  while (!queue.empty()) {
    const Arrival a = queue.top();
    queue.pop();
    if (bulk[a.cell] > 0) continue;
    bulk[a.cell] = -a.time;
    const double next = bulk[a.cell] - slope * solid.cell;
    for (const std::int32_t j : solid.near[a.cell])
      if (j >= 0 && bulk[j] == 0 && next > solid.thickness[j]) queue.push({-next, j});
  }
  return bulk;
}

// Weights of several joints side by side: a neighbour is looked up once for all of them.
constexpr int lanes = 8;
using Lanes = std::array<float, lanes>;
using LaneSums = std::array<double, lanes>;

// Conjugate gradients with Jacobi preconditioning on (L + diag(k)) w = diag(k) p, L the graph Laplacian of the cells, each
// lane a system of its own. Screened as it is, a few dozen steps do. `w` holds p before and the solution after. A lane stops
// when its residual has shrunk by ten thousand: weights are then right to four digits.
void solve(const VoxelSolid& solid, const std::vector<double>& k, std::vector<Lanes>& w) {
  const std::size_t n = k.size();
  std::vector<Lanes> residual(n), direction(n), image(n);
  std::vector<float> diagonal(n), inverse(n);
  for (std::size_t i = 0; i < n; ++i) {
    double d = k[i];
    for (const std::int32_t j : solid.near[i]) d += j >= 0;
    diagonal[i] = static_cast<float>(d);
    inverse[i] = static_cast<float>(1 / d);
  }
  const auto apply = [&](const std::vector<Lanes>& x, std::vector<Lanes>& y) {
    for (std::size_t i = 0; i < n; ++i) {
      Lanes sum = x[i];
      for (float& v : sum) v *= diagonal[i];
      for (const std::int32_t j : solid.near[i])
        if (j >= 0)
          for (int l = 0; l < lanes; ++l) sum[l] -= x[j][l];
      y[i] = sum;
    }
  };
  LaneSums rz{}, goal{};
  apply(w, image);  // starts at the seeds themselves: the residual is minus their Laplacian
  for (std::size_t i = 0; i < n; ++i)
    for (int l = 0; l < lanes; ++l) {
      residual[i][l] = static_cast<float>(k[i]) * w[i][l] - image[i][l];
      direction[i][l] = inverse[i] * residual[i][l];
      rz[l] += static_cast<double>(residual[i][l]) * direction[i][l];
    }
  for (int l = 0; l < lanes; ++l) goal[l] = 1e-8 * rz[l];
  for (int step = 0; step < 400; ++step) {
    bool going = false;
    for (int l = 0; l < lanes; ++l) going |= rz[l] > goal[l];
    if (!going) break;
    apply(direction, image);
    LaneSums curvature{}, next{};
    for (std::size_t i = 0; i < n; ++i)
      for (int l = 0; l < lanes; ++l) curvature[l] += static_cast<double>(direction[i][l]) * image[i][l];
    Lanes alpha, beta;
    for (int l = 0; l < lanes; ++l)
      alpha[l] = rz[l] > goal[l] && curvature[l] > 0 ? static_cast<float>(rz[l] / curvature[l]) : 0.0f;
    for (std::size_t i = 0; i < n; ++i)
      for (int l = 0; l < lanes; ++l) {
        w[i][l] += alpha[l] * direction[i][l];
        residual[i][l] -= alpha[l] * image[i][l];
        next[l] += static_cast<double>(residual[i][l]) * residual[i][l] * inverse[i];
      }
    for (int l = 0; l < lanes; ++l) {
      beta[l] = rz[l] > goal[l] ? static_cast<float>(next[l] / rz[l]) : 0.0f;
      if (rz[l] > goal[l]) rz[l] = next[l];
    }
    for (std::size_t i = 0; i < n; ++i)
      for (int l = 0; l < lanes; ++l) direction[i][l] = inverse[i] * residual[i][l] + beta[l] * direction[i][l];
  }
}

// Trilinear sampling among the cells that hang together with the one the point is in.
struct Stencil {
  std::array<std::int32_t, 8> cell{};
  std::array<double, 8> weight{};
  int count = 0;
};

Stencil stencil_at(const VoxelSolid& solid, const dvec3& p) {
  Stencil s;
  const int own = solid.find(p, 16 * solid.cell);
  if (own < 0) return s;
  const dvec3 q = (p - solid.centre(own)) / solid.cell;
  for (int corner = 0; corner < 8; ++corner) {
    double weight = 1;
    for (int a = 0; a < 3; ++a) {
      const double f = std::min(std::abs(q[a]), 0.5);
      weight *= corner >> a & 1 ? f : 1 - f;
    }
    // Any order of steps that stays in the solid will do.
    std::int32_t found = -1;
    std::array<int, 3> order{0, 1, 2};
    do {
      std::int32_t c = own;
      for (const int a : order)
        if (c >= 0 && (corner >> a & 1)) c = solid.near[c][2 * a + (q[a] > 0)];
      if (c >= 0) found = c;
    } while (found < 0 && std::next_permutation(order.begin(), order.end()));
    if (found < 0 || weight <= 0) continue;
    s.cell[s.count] = found;
    s.weight[s.count++] = weight;
  }
  double total = 0;
  for (int i = 0; i < s.count; ++i) total += s.weight[i];
  for (int i = 0; i < s.count; ++i) s.weight[i] /= total;
  return s;
}

}  // namespace

std::vector<BoneSegment> bone_segments(const std::vector<dvec3>& joints, const std::vector<int>& parents,
                                       const std::vector<dvec3>& points, const std::vector<double>& weights) {
  const std::size_t count = joints.size();
  std::vector<BoneSegment> bones;
  for (std::size_t j = 0; j < count; ++j) {
    double mass = 0;
    dvec3 middle(0);
    for (std::size_t p = 0; p < points.size(); ++p) {
      mass += weights[p * count + j];
      middle += weights[p * count + j] * points[p];
    }
    if (!(mass > 1e-6)) continue;
    middle /= mass;
    const std::size_t first = bones.size();
    for (std::size_t c = 0; c < count; ++c)
      if (parents[c] == static_cast<int>(j)) bones.push_back({static_cast<int>(j), joints[j], joints[c]});
    if (bones.size() == first) bones.push_back({static_cast<int>(j), joints[j], joints[j] + 1.8 * (middle - joints[j])});
    double sum = 0;
    for (std::size_t p = 0; p < points.size(); ++p) {
      const double w = weights[p * count + j];
      if (!(w > 0)) continue;
      double least = std::numeric_limits<double>::infinity();
      for (std::size_t b = first; b < bones.size(); ++b) least = std::min(least, distance_to(bones[b], points[p]));
      sum += w * least;
    }
    for (std::size_t b = first; b < bones.size(); ++b) bones[b].radius = std::max(sum / mass, 1e-3);
  }
  return bones;
}

Seeds seeds_of_bones(const VoxelSolid& solid, const std::vector<BoneSegment>& bones, int joints) {
  const std::size_t n = solid.places.size();
  std::vector<double> time(n, std::numeric_limits<double>::infinity());
  std::vector<int> owner(n, -1);
  std::vector<std::uint8_t> done(n, 0);
  std::priority_queue<Arrival, std::vector<Arrival>, std::greater<>> queue;
  for (std::size_t b = 0; b < bones.size(); ++b) {
    const double length = glm::length(bones[b].to - bones[b].from);
    const int steps = std::max(1, static_cast<int>(std::ceil(2 * length / solid.cell)));
    for (int k = 0; k <= steps; ++k) {
      const dvec3 p = glm::mix(bones[b].from, bones[b].to, static_cast<double>(k) / steps);
      const int cell = solid.find(p, 4 * bones[b].radius + 4 * solid.cell);
      if (cell < 0) continue;
      const double t = glm::length(solid.centre(cell) - p) / bones[b].radius;
      if (t < time[cell]) {
        time[cell] = t, owner[cell] = static_cast<int>(b);
        queue.push({t, cell});
      }
    }
  }
  while (!queue.empty()) {
    const Arrival a = queue.top();
    queue.pop();
    if (done[a.cell] || a.time != time[a.cell]) continue;
    done[a.cell] = 1;
    for (const std::int32_t j : solid.near[a.cell]) {
      if (j < 0 || done[j]) continue;
      // Only neighbours of the same bone: fronts of two bones do not help each other on.
      const int bone = owner[a.cell];
      std::array<double, 3> along;
      along.fill(std::numeric_limits<double>::infinity());
      for (int side = 0; side < 6; ++side) {
        const std::int32_t m = solid.near[j][side];
        if (m >= 0 && done[m] && owner[m] == bone) along[side / 2] = std::min(along[side / 2], time[m]);
      }
      const double t = eikonal(along, solid.cell, 1 / bones[bone].radius);
      if (t < time[j]) {
        time[j] = t, owner[j] = bone;
        queue.push({t, j});
      }
    }
  }
  // Cells that hang together with no bone (an eye, a horn of its own): by distance through the air.
  parallel_for(n, 256, [&](std::size_t i) {
    if (owner[i] >= 0) return;
    const dvec3 p = solid.centre(i);
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t b = 0; b < bones.size(); ++b) {
      const double d = distance_to(bones[b], p) / bones[b].radius;
      if (d < least) least = d, owner[i] = static_cast<int>(b);
    }
  });
  Seeds seeds(n * joints, 0.0f);
  for (std::size_t i = 0; i < n; ++i)
    if (owner[i] >= 0) seeds[i * joints + bones[owner[i]].joint] = 1;
  return seeds;
}

std::vector<double> diffuse_weights(const VoxelSolid& solid, const Seeds& seeds, int joints,
                                    const std::vector<dvec3>& points, const DiffusionOptions& options) {
  const std::size_t n = solid.places.size();
  check(seeds.size() == n * joints, "every cell needs a row of seeds");
  const std::vector<double> bulk = bulk_thickness(solid, options.slope);
  const double most = n > 0 ? options.most * *std::max_element(bulk.begin(), bulk.end()) : 0.0;
  std::vector<double> k(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double s = std::max(solid.cell, std::min(options.reach * bulk[i], most));
    k[i] = solid.cell * solid.cell / (s * s);
  }
  std::vector<Stencil> stencils(points.size());
  parallel_for(points.size(), 256, [&](std::size_t p) { stencils[p] = stencil_at(solid, points[p]); });
  std::vector<double> weights(points.size() * joints, 0.0);
  std::vector<int> used;  // joints that any cell is seeded with
  for (int j = 0; j < joints; ++j) {
    bool any = false;
    for (std::size_t i = 0; i < n && !any; ++i) any = seeds[i * joints + j] > 0;
    if (any) used.push_back(j);
  }
  parallel_for((used.size() + lanes - 1) / lanes, 1, [&](std::size_t group) {
    const std::size_t first = group * lanes, count = std::min<std::size_t>(lanes, used.size() - first);
    std::vector<Lanes> w(n, Lanes{});
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t l = 0; l < count; ++l) w[i][l] = seeds[i * joints + used[first + l]];
    solve(solid, k, w);
    for (std::size_t p = 0; p < points.size(); ++p)
      for (std::size_t l = 0; l < count; ++l) {
        double sum = 0;
        for (int i = 0; i < stencils[p].count; ++i) sum += stencils[p].weight[i] * w[stencils[p].cell[i]][l];
        weights[p * joints + used[first + l]] = std::max(sum, 0.0);
      }
  });
  for (std::size_t p = 0; p < points.size(); ++p) {
    double total = 0;
    for (int j = 0; j < joints; ++j) total += weights[p * joints + j];
    if (total > 0)
      for (int j = 0; j < joints; ++j) weights[p * joints + j] /= total;
  }
  return weights;
}

std::vector<Influence> strongest_influences(const double* weights, std::size_t joints) {
  std::vector<double> left(joints);
  for (std::size_t j = 0; j < left.size(); ++j) left[j] = weights[j];
  std::sort(left.begin(), left.end(), std::greater<>());
  // What the fifth weighs is taken off all: the four that stay fade out where another takes over, so none jumps.
  const double fifth = std::max(left.size() > 4 ? left[4] : 0.0, 0.01);
  double total = 0;
  for (std::size_t j = 0; j < left.size(); ++j) total += left[j] = std::max(weights[j] - fifth, 0.0);
  std::vector<Influence> result;
  for (std::size_t j = 0; j < left.size(); ++j)
    if (left[j] > 0) result.push_back({static_cast<std::uint32_t>(j), static_cast<float>(left[j] / total)});
  std::stable_sort(result.begin(), result.end(), [](const Influence& x, const Influence& y) { return x.weight > y.weight; });
  return result;
}

}  // namespace moomill
