#include "rigs/remesh.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "generator/core/error.h"
#include "generator/core/parallel.h"

namespace moomill {
namespace {

using Index = std::uint32_t;
constexpr Index gone = ~Index{0};

// The mesh being remeshed: triangles with a dead mark, and the triangles around every vertex.
struct Work {
  std::vector<dvec3> position;
  std::vector<std::uint8_t> border;
  std::vector<double> size;     // wanted edge length, metres
  std::vector<uvec3> triangle;  // x == gone: dead
  std::vector<std::vector<Index>> around;

  bool dead(Index t) const { return triangle[t].x == gone; }
  bool has(Index t, Index v) const { return triangle[t].x == v || triangle[t].y == v || triangle[t].z == v; }
  dvec3 normal(const uvec3& t) const {  // twice the area long
    return glm::cross(position[t.y] - position[t.x], position[t.z] - position[t.x]);
  }
};

// Triangles on both sides of an edge; more than two never occur, one means the border.
struct Sides {
  std::array<Index, 2> triangle{gone, gone};
  std::array<Index, 2> opposite{gone, gone};
  int count = 0;
};

Sides sides_of(const Work& w, Index a, Index b) {
  Sides s;
  for (const Index t : w.around[a]) {
    if (!w.has(t, b)) continue;
    if (s.count == 2) {
      s.count = 3;  // not a manifold edge: callers leave it alone
      return s;
    }
    const uvec3& v = w.triangle[t];
    s.triangle[s.count] = t;
    s.opposite[s.count++] = v.x + v.y + v.z - a - b;
  }
  return s;
}

void neighbours(const Work& w, Index v, std::vector<Index>& out) {
  out.clear();
  for (const Index t : w.around[v])
    for (int k = 0; k < 3; ++k)
      if (w.triangle[t][k] != v) out.push_back(w.triangle[t][k]);
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
}

void detach(Work& w, Index v, Index t) {
  auto& list = w.around[v];
  list.erase(std::find(list.begin(), list.end(), t));
}

void replace(uvec3& t, Index from, Index to) {
  for (int k = 0; k < 3; ++k)
    if (t[k] == from) t[k] = to;
}

double wanted(const Work& w, Index a, Index b) {
  return std::min(w.size[a], w.size[b]);
}

void split_edge(Work& w, const Field& field, Index a, Index b) {
  const Sides s = sides_of(w, a, b);
  if (s.count < 1 || s.count > 2) return;
  const Index m = static_cast<Index>(w.position.size());
  const bool border = s.count == 1;
  const dvec3 middle = 0.5 * (w.position[a] + w.position[b]), projected = field.project(middle, 1, border);
  // Where the field folds sharply the projection may land far away, and splitting would never end.
  const bool near = glm::length(projected - middle) < 0.25 * glm::length(w.position[a] - w.position[b]);
  w.position.push_back(near ? projected : middle);
  w.border.push_back(border);
  w.size.push_back(0.5 * (w.size[a] + w.size[b]));
  w.around.emplace_back();
  for (int i = 0; i < s.count; ++i) {
    const Index t = s.triangle[i], fresh = static_cast<Index>(w.triangle.size());
    uvec3 other = w.triangle[t];
    replace(other, a, m);          // m, b, opposite
    replace(w.triangle[t], b, m);  // a, m, opposite
    w.triangle.push_back(other);
    detach(w, b, t);
    w.around[b].push_back(fresh);
    w.around[s.opposite[i]].push_back(fresh);
    w.around[m].push_back(t);
    w.around[m].push_back(fresh);
  }
}

void split_long(Work& w, const Field& field) {
  for (Index t = 0; t < w.triangle.size(); ++t) {
    if (w.dead(t)) continue;
    // The longest edge first, again and again until none of this triangle is too long.
    for (int guard = 0; guard < 8; ++guard) {
      const uvec3 v = w.triangle[t];
      double worst = 4.0 / 3.0;
      int edge = -1;
      for (int k = 0; k < 3; ++k) {
        const double ratio =
            glm::length(w.position[v[k]] - w.position[v[(k + 1) % 3]]) / wanted(w, v[k], v[(k + 1) % 3]);
        if (ratio > worst) worst = ratio, edge = k;
      }
      if (edge < 0) break;
      split_edge(w, field, v[edge], v[(edge + 1) % 3]);
    }
  }
}

// Would the triangles around v, without those that hold `other`, keep facing the same way with v at p?
bool keeps_facing(const Work& w, Index v, Index other, const dvec3& p) {
  for (const Index t : w.around[v]) {
    if (w.has(t, other)) continue;
    const uvec3& c = w.triangle[t];
    std::array<dvec3, 3> x{w.position[c.x], w.position[c.y], w.position[c.z]};
    const dvec3 before = glm::cross(x[1] - x[0], x[2] - x[0]);
    for (int k = 0; k < 3; ++k)
      if (c[k] == v) x[k] = p;
    const dvec3 after = glm::cross(x[1] - x[0], x[2] - x[0]);
    const double la = glm::length(before), lb = glm::length(after);
    if (la < 1e-12) continue;  // a sliver faces nowhere
    const double longest = std::max(
        {glm::dot(x[1] - x[0], x[1] - x[0]), glm::dot(x[2] - x[1], x[2] - x[1]), glm::dot(x[0] - x[2], x[0] - x[2])});
    if (lb < 0.1 * longest || glm::dot(before, after) < 0.4 * la * lb) return false;
  }
  return true;
}

bool collapse_edge(Work& w, Index a, Index b, std::vector<Index>& na, std::vector<Index>& nb) {
  const Sides s = sides_of(w, a, b);
  if (s.count < 1 || s.count > 2) return false;
  if (w.border[a] && w.border[b] && s.count == 2) return false;
  if (w.border[b] && !w.border[a]) std::swap(a, b);  // b goes, a stays
  neighbours(w, a, na);
  neighbours(w, b, nb);
  // Link condition: the edge's two ends share no neighbours but the corners opposite the edge.
  int common = 0;
  for (const Index v : nb) {
    if (v == a) continue;
    if (std::binary_search(na.begin(), na.end(), v)) {
      ++common;
    } else if (w.border[a] && w.border[v] && !w.border[b]) {
      return false;  // would join two border vertices by an inner edge
    }
  }
  const std::size_t least = s.count == 1 ? 5 : 8;  // leaves three triangles around a border vertex, four around another
  if (common != s.count || w.around[a].size() + w.around[b].size() < least) return false;
  for (int i = 0; i < s.count; ++i)
    if (w.around[s.opposite[i]].size() < (w.border[s.opposite[i]] ? 3u : 5u)) return false;
  dvec3 p = w.position[a];
  if (w.border[a] == w.border[b]) p = 0.5 * (w.position[a] + w.position[b]);  // relaxing puts it back onto the surface
  for (const std::vector<Index>* list : {&na, &nb})
    for (const Index v : *list)
      if (v != a && v != b && glm::length(w.position[v] - p) > 4.0 / 3.0 * wanted(w, a, v)) return false;
  if (!keeps_facing(w, a, b, p) || !keeps_facing(w, b, a, p)) return false;
  for (int i = 0; i < s.count; ++i) {
    const Index t = s.triangle[i];
    detach(w, a, t);
    detach(w, s.opposite[i], t);
    detach(w, b, t);
    w.triangle[t].x = gone;
  }
  for (const Index t : w.around[b]) {
    replace(w.triangle[t], b, a);
    w.around[a].push_back(t);
  }
  w.around[b].clear();
  w.position[a] = p;
  w.size[a] = std::min(w.size[a], w.size[b]);
  return true;
}

void collapse_short(Work& w) {
  std::vector<Index> na, nb;
  for (Index t = 0; t < w.triangle.size(); ++t)
    for (int k = 0; k < 3 && !w.dead(t); ++k) {
      const Index a = w.triangle[t][k], b = w.triangle[t][(k + 1) % 3];
      if (glm::length(w.position[a] - w.position[b]) < 4.0 / 5.0 * wanted(w, a, b) && collapse_edge(w, a, b, na, nb))
        k = -1;
    }
}

double worst_angle_measure(const Work& w, Index a, Index b, Index c) {  // sine-like: 1 for equilateral, 0 for a sliver
  const dvec3 ab = w.position[b] - w.position[a], ac = w.position[c] - w.position[a],
              bc = w.position[c] - w.position[b];
  return glm::length(glm::cross(ab, ac)) / std::max({glm::dot(ab, ab), glm::dot(ac, ac), glm::dot(bc, bc), 1e-20}) /
         0.8660254;
}

// Flips towards valence 6 (4 on the border), or where it mends a sliver.
void flip_edges(Work& w) {
  for (Index t = 0; t < w.triangle.size(); ++t)
    for (int k = 0; k < 3 && !w.dead(t); ++k) {
      const Index a = w.triangle[t][k], b = w.triangle[t][(k + 1) % 3];
      const Sides s = sides_of(w, a, b);
      if (s.count != 2) continue;
      const Index c = w.triangle[t][(k + 2) % 3], d = s.opposite[0] == c ? s.opposite[1] : s.opposite[0];
      const Index u = s.triangle[0] == t ? s.triangle[1] : s.triangle[0];
      if (c == d || (w.border[c] && w.border[d])) continue;
      if (w.around[a].size() < 4 || w.around[b].size() < 4) continue;
      if (sides_of(w, c, d).count > 0) continue;  // they are neighbours already
      const auto off = [&](Index v, int change) {
        const int best = w.border[v] ? 3 : 6;  // triangles around it
        const int n = static_cast<int>(w.around[v].size()) + change - best;
        return n * n;
      };
      const int before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0),
                after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
      const double bad = std::min(worst_angle_measure(w, a, b, c), worst_angle_measure(w, b, a, d));
      const double mended = std::min(worst_angle_measure(w, a, d, c), worst_angle_measure(w, d, b, c));
      if (!(after < before && mended > 0.3) && !(bad < 0.3 && mended > 1.5 * bad)) continue;
      const uvec3 first(a, d, c), second(d, b, c);
      const dvec3 was = glm::normalize(w.normal(w.triangle[t])) + glm::normalize(w.normal(w.triangle[u]));
      const dvec3 n1 = w.normal(first), n2 = w.normal(second);
      if (!(glm::dot(was, n1) > 1.2 * glm::length(n1)) || !(glm::dot(was, n2) > 1.2 * glm::length(n2))) continue;
      w.triangle[t] = first;
      w.triangle[u] = second;
      detach(w, b, t);
      detach(w, a, u);
      w.around[d].push_back(t);
      w.around[c].push_back(u);
    }
}

// Moves every vertex to the centre of its neighbours along the surface, all at once. Border vertices see their
// neighbours' mirror images too, so they keep to y = 0.
void relax(Work& w, const Field& field, int steps) {
  std::vector<dvec3> moved(w.position);
  parallel_for(w.position.size(), 256, [&](std::size_t i) {
    if (w.around[i].empty()) return;  // collapsed away
    std::vector<Index> near;
    neighbours(w, static_cast<Index>(i), near);
    dvec3 sum(0.0), normal(0.0);
    double total = 0;
    for (const Index v : near) {
      const double weight = (w.border[i] && !w.border[v] ? 2.0 : 1.0) / w.size[v];
      sum += weight * w.position[v];
      total += weight;
    }
    for (const Index t : w.around[i]) normal += w.normal(w.triangle[t]);
    dvec3 step = sum / total - w.position[i];
    if (w.border[i]) step.y = 0, normal.y = 0;
    const double length = glm::length(normal);
    if (length > 0) step -= normal * (glm::dot(step, normal) / (length * length));
    const dvec3 p = field.project(w.position[i] + 0.7 * step, steps, w.border[i]);
    // Near a crease the projection may jump to another sheet; then the vertex stays.
    if (glm::length(p - w.position[i]) < w.size[i] && (w.border[i] || p.y > 1e-4)) moved[i] = p;
  });
  w.position = std::move(moved);
}

// Where triangles still lie back on each other or are slivers, the field has a crease that no edge length resolves:
// there vertices go to the middle of their neighbours, off the field, until the surface lies open.
void lay_open(Work& w) {
  constexpr double fold = -0.35, sliver = 0.12;  // cosine between neighbours' normals; as worst_angle_measure
  std::vector<Index> near;
  for (int round = 0; round < 20; ++round) {
    std::vector<std::uint8_t> bad(w.position.size(), 0);
    bool any = false;
    for (Index t = 0; t < w.triangle.size(); ++t) {
      if (w.dead(t)) continue;
      const uvec3 v = w.triangle[t];
      bool here = worst_angle_measure(w, v.x, v.y, v.z) < sliver;
      const dvec3 n = w.normal(v);
      for (int k = 0; k < 3 && !here; ++k) {
        const Sides s = sides_of(w, v[k], v[(k + 1) % 3]);
        if (s.count != 2) continue;
        const dvec3 m = w.normal(w.triangle[s.triangle[0] == t ? s.triangle[1] : s.triangle[0]]);
        here = glm::dot(n, m) < fold * glm::length(n) * glm::length(m);
      }
      if (here) bad[v.x] = bad[v.y] = bad[v.z] = 1, any = true;
    }
    if (!any) return;
    const std::vector<std::uint8_t> core = bad;
    for (Index i = 0; i < w.position.size(); ++i) {
      if (!core[i]) continue;
      neighbours(w, i, near);
      for (const Index v : near) bad[v] = 1;
    }
    std::vector<dvec3> moved(w.position);
    for (Index i = 0; i < w.position.size(); ++i) {
      if (!bad[i] || w.around[i].empty()) continue;
      neighbours(w, i, near);
      dvec3 sum(0);
      double total = 0;
      for (const Index v : near) {
        const double weight = w.border[i] && !w.border[v] ? 2 : 1;  // its mirror image too
        sum += weight * w.position[v], total += weight;
      }
      moved[i] = glm::mix(w.position[i], sum / total, core[i] ? 0.6 : 0.3);
      if (w.border[i]) moved[i].y = 0;
    }
    w.position = std::move(moved);
    flip_edges(w);
  }
}

// What edges at a point may be at most, in shares of the target, for a surface bent with `curvature` (1 / radius): a
// chord's sagitta grows with length^2 / radius, so lengths go with the square root of the radius. Flatter than
// `full_radius` nothing is asked; creases are not followed to the end.
constexpr double full_radius = 0.045, finest_share = 0.3;  // metres; share of the target edge
double share_for(double curvature) {
  return std::clamp(std::sqrt(1 / std::max(curvature * full_radius, 1e-9)), finest_share, 1.0);
}

// Largest normal curvature of the field along the edges around each vertex.
std::vector<double> curvatures(const Work& w, const Field& field) {
  const std::size_t n = w.position.size();
  std::vector<dvec3> normal(n);
  std::vector<double> bend(n, 0.0), even(n, 0.0);
  parallel_for(n, 64, [&](std::size_t i) {
    if (w.around[i].empty()) return;
    dvec3 g = field.gradient(w.position[i]);
    if (w.border[i]) g.y = 0;
    const double length = glm::length(g);
    if (length > 0) normal[i] = g / length;
  });
  const auto each = [&](auto body) {
    parallel_for(n, 256, [&](std::size_t i) {
      if (w.around[i].empty()) return;
      std::vector<Index> near;
      neighbours(w, static_cast<Index>(i), near);
      body(i, near);
    });
  };
  each([&](std::size_t i, const std::vector<Index>& near) {
    for (const Index v : near) {
      const dvec3 e = w.position[v] - w.position[i];
      bend[i] = std::max(bend[i], std::abs(glm::dot(normal[v] - normal[i], e)) / std::max(glm::dot(e, e), 1e-12));
    }
  });
  each([&](std::size_t i, const std::vector<Index>& near) {  // one vertex alone may be off
    double sum = bend[i];
    for (const Index v : near) sum += bend[v];
    even[i] = sum / static_cast<double>(near.size() + 1);
  });
  return even;
}

void refresh_sizes(Work& w, const Field& field, double target_edge, bool bent) {
  const std::vector<double> bend = bent ? curvatures(w, field) : std::vector<double>(w.position.size(), 0.0);
  parallel_for(w.position.size(), 256, [&](std::size_t i) {
    if (w.around[i].empty()) return;
    w.size[i] = target_edge * std::min(field.sample(w.position[i]).detail, share_for(bend[i]));
  });
  // Wanted lengths grow slowly away from fine parts, or their borders would be fans.
  for (int sweep = 0; sweep < 2; ++sweep)
    for (Index t = 0; t < w.triangle.size(); ++t) {
      if (w.dead(t)) continue;
      for (int k = 0; k < 6; ++k) {
        const Index a = w.triangle[t][k % 3], b = w.triangle[t][(k + 1 + k / 3) % 3];
        w.size[a] = std::min(w.size[a], w.size[b] + 0.3 * glm::length(w.position[a] - w.position[b]));
      }
    }
}

Work work_on(std::vector<dvec3> positions, std::vector<std::uint8_t> border, std::vector<uvec3> triangles) {
  Work w;
  w.position = std::move(positions);
  w.border = std::move(border);
  w.triangle = std::move(triangles);
  w.around.resize(w.position.size());
  w.size.resize(w.position.size());
  for (Index t = 0; t < w.triangle.size(); ++t)
    for (int k = 0; k < 3; ++k) w.around[w.triangle[t][k]].push_back(t);
  return w;
}

// What is left of it, numbered afresh.
HalfMesh compacted(const Work& w) {
  std::vector<Index> number(w.position.size(), gone);
  HalfMesh mesh;
  for (Index t = 0; t < w.triangle.size(); ++t) {
    if (w.dead(t)) continue;
    uvec3 triangle;
    for (int k = 0; k < 3; ++k) {
      const Index v = w.triangle[t][k];
      if (number[v] == gone) {
        number[v] = static_cast<Index>(mesh.positions.size());
        mesh.positions.push_back(w.position[v]);
        mesh.on_midplane.push_back(w.border[v]);
      }
      triangle[k] = number[v];
    }
    mesh.triangles.push_back(triangle);
  }
  return mesh;
}

}  // namespace

void remesh(HalfMesh& mesh, const Field& field, double target_edge, int rounds) {
  Work w = work_on(std::move(mesh.positions), std::move(mesh.on_midplane), std::move(mesh.triangles));
  for (int round = 0; round < rounds; ++round) {
    refresh_sizes(w, field, target_edge, round > 0);
    split_long(w, field);
    collapse_short(w);
    if (round == 0) {  // most of the lattice's triangles are gone now
      mesh = compacted(w);
      w = work_on(std::move(mesh.positions), std::move(mesh.on_midplane), std::move(mesh.triangles));
      refresh_sizes(w, field, target_edge, false);
    }
    flip_edges(w);
    relax(w, field, 1);
  }
  relax(w, field, 3);
  flip_edges(w);
  lay_open(w);
  mesh = compacted(w);
}

}  // namespace moomill
