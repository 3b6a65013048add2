// Flattening of one chart: as rigid as possible, and what came of it.
#include <algorithm>
#include <array>
#include <cmath>

#include "rigs/unwrap.h"

namespace moomill {
namespace {

using Index = std::uint32_t;

// Triangles with the chart's own vertex numbers.
std::vector<std::array<Index, 3>> local_triangles(const Chart& chart, const std::vector<uvec3>& triangles) {
  std::vector<std::array<Index, 3>> local;
  local.reserve(chart.triangles.size());
  for (const Index t : chart.triangles) {
    std::array<Index, 3> v{};
    for (int k = 0; k < 3; ++k)
      v[k] = static_cast<Index>(std::lower_bound(chart.vertices.begin(), chart.vertices.end(), triangles[t][k]) -
                                chart.vertices.begin());
    local.push_back(v);
  }
  return local;
}

double cross2(const dvec2& a, const dvec2& b) {
  return a.x * b.y - a.y * b.x;
}

// A triangle laid into the plane: its first corner at 0, its first edge along x.
struct Laid {
  dvec2 b{0}, c{0};
};
Laid lay(const dvec3& p, const dvec3& q, const dvec3& r) {
  const double length = glm::length(q - p);
  if (!(length > 0)) return {};
  const double along = glm::dot(r - p, q - p) / length;
  return {{length, 0}, {along, glm::length(glm::cross(q - p, r - p)) / length}};
}

// The cotangent Laplacian, symmetric, by rows.
struct Laplacian {
  std::vector<Index> begin, column;
  std::vector<double> weight, diagonal;

  void apply(const std::vector<dvec2>& x, std::vector<dvec2>& out) const {
    for (std::size_t i = 0; i < diagonal.size(); ++i) {
      dvec2 sum = diagonal[i] * x[i];
      for (Index k = begin[i]; k < begin[i + 1]; ++k) sum -= weight[k] * x[column[k]];
      out[i] = sum;
    }
  }
};

Laplacian laplacian(std::size_t vertices, const std::vector<std::array<Index, 3>>& local,
                    const std::vector<std::array<double, 3>>& cotangents) {
  struct Entry {
    Index row, column;
    double weight;
  };
  std::vector<Entry> entries;
  for (std::size_t t = 0; t < local.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const Index a = local[t][k], b = local[t][(k + 1) % 3];
      entries.push_back({a, b, cotangents[t][k]});
      entries.push_back({b, a, cotangents[t][k]});
    }
  std::stable_sort(entries.begin(), entries.end(), [](const Entry& x, const Entry& y) {
    return x.row != y.row ? x.row < y.row : x.column < y.column;
  });
  Laplacian m;
  m.begin.assign(vertices + 1, 0);
  m.diagonal.assign(vertices, 0);
  for (std::size_t i = 0; i < entries.size(); ++i) {
    const Entry& e = entries[i];
    m.diagonal[e.row] += e.weight;
    if (i > 0 && entries[i - 1].row == e.row && entries[i - 1].column == e.column) {
      m.weight.back() += e.weight;
    } else {
      m.column.push_back(e.column);
      m.weight.push_back(e.weight);
      ++m.begin[e.row + 1];
    }
  }
  for (std::size_t i = 0; i < vertices; ++i) m.begin[i + 1] += m.begin[i];
  return m;
}

// Conjugate gradients with the diagonal as preconditioner, from x. The system is singular (translations) but its
// right-hand side is not in the way of that.
void solve(const Laplacian& m, const std::vector<dvec2>& right, std::vector<dvec2>& x, int most) {
  const std::size_t n = x.size();
  std::vector<dvec2> residual(n), direction(n), image(n);
  m.apply(x, image);
  const auto dot = [&](const std::vector<dvec2>& a, const std::vector<dvec2>& b, bool preconditioned) {
    dvec2 sum(0);
    for (std::size_t i = 0; i < n; ++i) sum += a[i] * b[i] / (preconditioned ? m.diagonal[i] : 1.0);
    return sum;
  };
  for (std::size_t i = 0; i < n; ++i) {
    residual[i] = right[i] - image[i];
    direction[i] = residual[i] / m.diagonal[i];
  }
  dvec2 rho = dot(residual, residual, true);
  const dvec2 goal = 1e-6 * dot(right, right, true) + 1e-30;  // both coordinates, squared: a thousandth
  for (int step = 0; step < most && (rho.x > goal.x || rho.y > goal.y); ++step) {
    m.apply(direction, image);
    const dvec2 curvature = dot(direction, image, false);
    const dvec2 alpha(curvature.x > 0 ? rho.x / curvature.x : 0, curvature.y > 0 ? rho.y / curvature.y : 0);
    for (std::size_t i = 0; i < n; ++i) {
      x[i] += alpha * direction[i];
      residual[i] -= alpha * image[i];
    }
    const dvec2 next = dot(residual, residual, true);
    const dvec2 beta(rho.x > 0 ? next.x / rho.x : 0, rho.y > 0 ? next.y / rho.y : 0);
    for (std::size_t i = 0; i < n; ++i) direction[i] = residual[i] / m.diagonal[i] + beta * direction[i];
    rho = next;
  }
}

}  // namespace

void flatten_rigidly(Chart& chart, const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles,
                     int rounds) {
  const std::vector<std::array<Index, 3>> local = local_triangles(chart, triangles);
  std::vector<Laid> laid;
  std::vector<std::array<double, 3>> cotangents;  // of the angle opposite edge k, k+1
  double area = 0;
  for (const Index t : chart.triangles) {
    const uvec3& v = triangles[t];
    const Laid l = lay(positions[v.x], positions[v.y], positions[v.z]);
    const std::array<dvec2, 3> p{dvec2(0), l.b, l.c};
    std::array<double, 3> cot{};
    for (int k = 0; k < 3; ++k) {
      const dvec2 a = p[k] - p[(k + 2) % 3], b = p[(k + 1) % 3] - p[(k + 2) % 3];
      // Never negative, so that the matrix stays definite; never huge, whatever the triangle.
      cot[k] = std::clamp(glm::dot(a, b) / std::max(cross2(a, b), 1e-12), 0.02, 20.0);
    }
    laid.push_back(l);
    cotangents.push_back(cot);
    area += 0.5 * cross2(l.b, l.c);
  }
  const Laplacian m = laplacian(chart.vertices.size(), local, cotangents);
  std::vector<dvec2> right(chart.vertices.size());
  for (int round = 0; round < rounds; ++round) {
    std::fill(right.begin(), right.end(), dvec2(0));
    for (std::size_t t = 0; t < local.size(); ++t) {
      const std::array<dvec2, 3> p{dvec2(0), laid[t].b, laid[t].c};
      // The rotation nearest to the triangle's map, as cosine and sine.
      double c = 0, s = 0;
      for (int k = 0; k < 3; ++k) {
        const dvec2 e = p[(k + 1) % 3] - p[k], f = chart.flat[local[t][(k + 1) % 3]] - chart.flat[local[t][k]];
        c += cotangents[t][k] * glm::dot(e, f);
        s += cotangents[t][k] * cross2(e, f);
      }
      const double length = std::hypot(c, s);
      if (!(length > 0)) continue;
      c /= length, s /= length;
      for (int k = 0; k < 3; ++k) {
        const dvec2 e = p[(k + 1) % 3] - p[k], turned(c * e.x - s * e.y, s * e.x + c * e.y);
        right[local[t][(k + 1) % 3]] += cotangents[t][k] * turned;
        right[local[t][k]] -= cotangents[t][k] * turned;
      }
    }
    solve(m, right, chart.flat, 60);
  }
  double flat_area = 0;
  for (const auto& v : local)
    flat_area += 0.5 * cross2(chart.flat[v[1]] - chart.flat[v[0]], chart.flat[v[2]] - chart.flat[v[0]]);
  if (flat_area > 0)
    for (dvec2& p : chart.flat) p *= std::sqrt(area / flat_area);
}

Stretch measure_stretch(const Chart& chart, const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles) {
  Stretch result;
  double off = 0, total = 0;
  const std::vector<std::array<Index, 3>> local = local_triangles(chart, triangles);
  for (std::size_t t = 0; t < local.size(); ++t) {
    const uvec3& v = triangles[chart.triangles[t]];
    const Laid l = lay(positions[v.x], positions[v.y], positions[v.z]);
    const dvec2 b = chart.flat[local[t][1]] - chart.flat[local[t][0]],
                c = chart.flat[local[t][2]] - chart.flat[local[t][0]];
    const double area = cross2(l.b, l.c), flat = cross2(b, c);
    if (!(flat > 1e-6 * area)) {
      result.turned_over = true;
      result.worst = std::numeric_limits<double>::infinity();
      return result;
    }
    const glm::dmat2 j = glm::dmat2(b, c) * glm::inverse(glm::dmat2(l.b, l.c));
    const double e = 0.5 * (glm::dot(j[0], j[0]) + glm::dot(j[1], j[1])), det = flat / area;
    const double large = std::sqrt(e + std::sqrt(std::max(e * e - det * det, 0.0)));
    result.worst = std::max({result.worst, large, large / det});
    const double even = std::sqrt(det);
    if (even > 1.12 || even < 1 / 1.12) off += area;
    total += area;
  }
  result.uneven = total > 0 ? off / total : 0;
  return result;
}

bool border_crosses(const Chart& chart, const std::vector<uvec3>& triangles) {
  const std::vector<std::array<Index, 3>> local = local_triangles(chart, triangles);
  std::vector<std::pair<std::uint64_t, bool>> half;  // both ends ascending; once for every triangle
  for (const auto& v : local)
    for (int k = 0; k < 3; ++k) {
      const Index a = v[k], b = v[(k + 1) % 3];
      half.emplace_back((static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b), a < b);
    }
  std::sort(half.begin(), half.end());
  struct Segment {
    Index a, b;
    double low, high;  // of x
  };
  std::vector<Segment> border;
  for (std::size_t i = 0; i < half.size(); ++i) {
    if ((i > 0 && half[i - 1].first == half[i].first) || (i + 1 < half.size() && half[i + 1].first == half[i].first))
      continue;
    const Index a = static_cast<Index>(half[i].first >> 32), b = static_cast<Index>(half[i].first);
    border.push_back(
        {a, b, std::min(chart.flat[a].x, chart.flat[b].x), std::max(chart.flat[a].x, chart.flat[b].x)});
  }
  std::stable_sort(border.begin(), border.end(), [](const Segment& x, const Segment& y) { return x.low < y.low; });
  const auto side = [&](const dvec2& a, const dvec2& b, const dvec2& p) { return cross2(b - a, p - a); };
  std::vector<int> uses(chart.vertices.size(), 0);
  for (const Segment& s : border)
    if (++uses[s.a] > 2 || ++uses[s.b] > 2) return true;  // touches itself in a corner
  for (std::size_t i = 0; i < border.size(); ++i)
    for (std::size_t j = i + 1; j < border.size() && border[j].low <= border[i].high; ++j) {
      const Segment &u = border[i], &v = border[j];
      if (u.a == v.a || u.a == v.b || u.b == v.a || u.b == v.b) continue;
      const dvec2 &a = chart.flat[u.a], &b = chart.flat[u.b], &c = chart.flat[v.a], &d = chart.flat[v.b];
      if (std::min(a.y, b.y) > std::max(c.y, d.y) || std::min(c.y, d.y) > std::max(a.y, b.y)) continue;
      if (side(a, b, c) * side(a, b, d) <= 0 && side(c, d, a) * side(c, d, b) <= 0) return true;
    }
  return false;
}

}  // namespace moomill
