#include "rigs/mesh_checks.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>
#include <tuple>
#include <unordered_map>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/topology.h"

namespace moomill {
namespace {

using Index = std::uint32_t;
constexpr Index none = ~Index{0};

int sign(double v) {
  return (v > 0) - (v < 0);
}

// Sign of the volume of (a, b, c, d): exact for floats whose exponents span no more than some 13 bits, which is
// what 113 bits leave room for; beyond that the least of them may be rounded.
template <class T>
int orientation_in(const dvec3& a, const dvec3& b, const dvec3& c, const dvec3& d) {
  const T ax = T(a.x) - T(d.x), ay = T(a.y) - T(d.y), az = T(a.z) - T(d.z);
  const T bx = T(b.x) - T(d.x), by = T(b.y) - T(d.y), bz = T(b.z) - T(d.z);
  const T cx = T(c.x) - T(d.x), cy = T(c.y) - T(d.y), cz = T(c.z) - T(d.z);
  const T v = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
  return (v > 0) - (v < 0);
}

int orientation(const dvec3& a, const dvec3& b, const dvec3& c, const dvec3& d) {
  const dvec3 u = a - d, v = b - d, w = c - d;
  const double det = glm::dot(u, glm::cross(v, w));
  // Larger than any error of the line above (Shewchuk 1997 gives 7.8e-16 times the permanent).
  const dvec3 au = glm::abs(u), av = glm::abs(v), aw = glm::abs(w);
  const double permanent = au.x * (av.y * aw.z + av.z * aw.y) + au.y * (av.z * aw.x + av.x * aw.z) +
                           au.z * (av.x * aw.y + av.y * aw.x);
  if (std::abs(det) > 1e-15 * permanent) return sign(det);
  return orientation_in<__float128>(a, b, c, d);
}

int orientation(const dvec2& a, const dvec2& b, const dvec2& c) {
  using T = __float128;
  const T v = (T(b.x) - T(a.x)) * (T(c.y) - T(a.y)) - (T(b.y) - T(a.y)) * (T(c.x) - T(a.x));
  return (v > 0) - (v < 0);
}

bool segments_meet(const dvec2& a, const dvec2& b, const dvec2& c, const dvec2& d) {
  const int c1 = orientation(a, b, c), c2 = orientation(a, b, d), c3 = orientation(c, d, a), c4 = orientation(c, d, b);
  if (c1 * c2 < 0 && c3 * c4 < 0) return true;
  const auto on = [](const dvec2& p, const dvec2& q, const dvec2& r) {
    return r.x >= std::min(p.x, q.x) && r.x <= std::max(p.x, q.x) && r.y >= std::min(p.y, q.y) &&
           r.y <= std::max(p.y, q.y);
  };
  return (c1 == 0 && on(a, b, c)) || (c2 == 0 && on(a, b, d)) || (c3 == 0 && on(c, d, a)) || (c4 == 0 && on(c, d, b));
}

using Corners = std::array<dvec3, 3>;

// The segment and the triangle lie in one plane.
bool meet_in_plane(const dvec3& p, const dvec3& q, const Corners& t) {
  const dvec3 n = glm::abs(glm::cross(t[1] - t[0], t[2] - t[0]));
  const int drop = n.x >= n.y && n.x >= n.z ? 0 : n.y >= n.z ? 1 : 2;
  const auto flat = [&](const dvec3& v) { return dvec2(v[(drop + 1) % 3], v[(drop + 2) % 3]); };
  const dvec2 a = flat(t[0]), b = flat(t[1]), c = flat(t[2]), u = flat(p), v = flat(q);
  if (segments_meet(u, v, a, b) || segments_meet(u, v, b, c) || segments_meet(u, v, c, a)) return true;
  const int s1 = orientation(a, b, u), s2 = orientation(b, c, u), s3 = orientation(c, a, u);
  return s1 != 0 && s1 == s2 && s2 == s3;
}

bool segment_meets_triangle(const dvec3& p, const dvec3& q, const Corners& t) {
  const int sp = orientation(t[0], t[1], t[2], p), sq = orientation(t[0], t[1], t[2], q);
  if (sp == 0 && sq == 0) return meet_in_plane(p, q, t);
  if (sp * sq > 0) return false;
  const int s1 = orientation(p, q, t[0], t[1]), s2 = orientation(p, q, t[1], t[2]), s3 = orientation(p, q, t[2], t[0]);
  return (s1 >= 0 && s2 >= 0 && s3 >= 0) || (s1 <= 0 && s2 <= 0 && s3 <= 0);
}

// Do two triangles meet anywhere but at the corners they share? `u`, `v` are places of their corners.
bool meet(const uvec3& u, const Corners& a, const uvec3& v, const Corners& b) {
  std::array<int, 3> in_a{}, in_b{};
  int shared = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      if (u[i] == v[j]) in_a[i] = 1, in_b[j] = 1, ++shared;
  if (shared == 0) {
    for (int k = 0; k < 3; ++k)
      if (segment_meets_triangle(a[k], a[(k + 1) % 3], b) || segment_meets_triangle(b[k], b[(k + 1) % 3], a))
        return true;
    return false;
  }
  const auto odd = [](const std::array<int, 3>& flags, int which) {
    return static_cast<int>(std::find(flags.begin(), flags.end(), which) - flags.begin());
  };
  if (shared == 1) {
    const int i = odd(in_a, 1), j = odd(in_b, 1);
    return segment_meets_triangle(a[(i + 1) % 3], a[(i + 2) % 3], b) ||
           segment_meets_triangle(b[(j + 1) % 3], b[(j + 2) % 3], a);
  }
  if (shared > 2) return true;
  // A common edge: only triangles folded flat onto each other overlap.
  const int i = odd(in_a, 0), j = odd(in_b, 0);
  if (orientation(a[0], a[1], a[2], b[j]) != 0) return false;
  const dvec3 p = a[(i + 1) % 3], edge = a[(i + 2) % 3] - p;
  return glm::dot(glm::cross(edge, a[i] - p), glm::cross(edge, b[j] - p)) > 0;
}

// A tree of boxes over the triangles, halved at the median of the widest axis.
struct Tree {
  struct Node {
    vec3 lower, upper;
    Index first, count;  // leaf: entries of `order`; inner: count 0, children at `first` and `first` + 1
  };
  std::vector<Node> nodes;
  std::vector<Index> order;
};

Tree build_tree(const std::vector<vec3>& lower, const std::vector<vec3>& upper) {
  Tree tree;
  tree.order.resize(lower.size());
  std::iota(tree.order.begin(), tree.order.end(), Index{0});
  struct Task {
    Index node, first, last;
  };
  tree.nodes.emplace_back();
  std::vector<Task> tasks{{0, 0, static_cast<Index>(lower.size())}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    vec3 low(std::numeric_limits<float>::infinity()), high = -low, centre_low = low, centre_high = high;
    for (Index i = task.first; i < task.last; ++i) {
      const Index t = tree.order[i];
      const vec3 centre = lower[t] + upper[t];
      low = glm::min(low, lower[t]), high = glm::max(high, upper[t]);
      centre_low = glm::min(centre_low, centre), centre_high = glm::max(centre_high, centre);
    }
    tree.nodes[task.node] = {low, high, task.first, task.last - task.first};
    if (task.last - task.first <= 4) continue;
    const vec3 size = centre_high - centre_low;
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const Index middle = (task.first + task.last) / 2;
    const auto at = [&](Index i) { return tree.order.begin() + i; };
    std::nth_element(at(task.first), at(middle), at(task.last), [&](Index a, Index b) {
      const float ca = lower[a][axis] + upper[a][axis], cb = lower[b][axis] + upper[b][axis];
      return ca != cb ? ca < cb : a < b;
    });
    const Index children = static_cast<Index>(tree.nodes.size());
    tree.nodes[task.node].first = children, tree.nodes[task.node].count = 0;
    tree.nodes.resize(tree.nodes.size() + 2);
    tasks.push_back({children, task.first, middle});
    tasks.push_back({children + 1, middle, task.last});
  }
  return tree;
}

void find_intersections(const std::vector<vec3>& positions, const std::vector<uvec3>& triangles,
                        const std::vector<uvec3>& placed, MeshChecks& found) {
  const std::size_t n = triangles.size();
  std::vector<vec3> lower(n), upper(n);
  for (std::size_t t = 0; t < n; ++t) {
    const vec3 &a = positions[triangles[t].x], &b = positions[triangles[t].y], &c = positions[triangles[t].z];
    lower[t] = glm::min(a, glm::min(b, c)), upper[t] = glm::max(a, glm::max(b, c));
  }
  const Tree tree = build_tree(lower, upper);
  const auto apart = [](const vec3& l0, const vec3& u0, const vec3& l1, const vec3& u1) {
    return l0.x > u1.x || l1.x > u0.x || l0.y > u1.y || l1.y > u0.y || l0.z > u1.z || l1.z > u0.z;
  };
  const auto corners = [&](Index t) {
    return Corners{dvec3(positions[triangles[t].x]), dvec3(positions[triangles[t].y]), dvec3(positions[triangles[t].z])};
  };
  std::vector<std::vector<Index>> hits(n);
  parallel_for(n, 256, [&](std::size_t i) {
    const Index t = static_cast<Index>(i);
    const Corners own = corners(t);
    std::vector<Index> stack{0};
    while (!stack.empty()) {
      const Tree::Node& node = tree.nodes[stack.back()];
      stack.pop_back();
      if (apart(node.lower, node.upper, lower[t], upper[t])) continue;
      if (node.count == 0) {
        stack.push_back(node.first);
        stack.push_back(node.first + 1);
        continue;
      }
      for (Index k = node.first; k < node.first + node.count; ++k) {
        const Index u = tree.order[k];
        if (u <= t || apart(lower[u], upper[u], lower[t], upper[t])) continue;
        if (meet(placed[t], own, placed[u], corners(u))) hits[t].push_back(u);
      }
    }
  });
  for (Index t = 0; t < n; ++t) {
    std::sort(hits[t].begin(), hits[t].end());
    found.self_intersections += hits[t].size();
    for (const Index u : hits[t])
      if (found.intersecting.size() < 100) found.intersecting.emplace_back(t, u);
  }
}

// Value below which a share of the total weight lies.
double percentile(const std::vector<std::pair<double, double>>& sorted, double total, double share) {
  double sum = 0;
  for (const auto& [value, weight] : sorted) {
    sum += weight;
    if (sum >= share * total) return value;
  }
  return sorted.empty() ? 0 : sorted.back().first;
}

}  // namespace

MeshChecks check_mesh(const std::vector<vec3>& positions, const std::vector<uvec3>& triangles,
                      const std::vector<std::uint32_t>& place, bool intersections) {
  check(place.size() == positions.size(), "check_mesh: one place per vertex");
  MeshChecks found;
  found.triangles = triangles.size();
  if (triangles.empty()) return found;
  const std::size_t places = *std::max_element(place.begin(), place.end()) + std::size_t{1};
  std::vector<uvec3> placed;  // with the places of their corners
  placed.reserve(triangles.size());
  std::vector<std::uint8_t> collapsed(triangles.size(), 0);
  std::vector<double> angles;
  double shortest = std::numeric_limits<double>::infinity();
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const uvec3& v = triangles[t];
    placed.emplace_back(place[v.x], place[v.y], place[v.z]);
    const uvec3& p = placed.back();
    collapsed[t] = p.x == p.y || p.y == p.z || p.z == p.x;
    const Corners c{dvec3(positions[v.x]), dvec3(positions[v.y]), dvec3(positions[v.z])};
    const dvec3 cross = glm::cross(c[1] - c[0], c[2] - c[0]);
    const double twice = glm::length(cross);
    found.area += 0.5 * twice;
    found.volume += glm::dot(c[0], glm::cross(c[1], c[2])) / 6;
    double least = pi, longest = 0;
    for (int k = 0; k < 3; ++k) {
      const dvec3 a = c[(k + 1) % 3] - c[k], b = c[(k + 2) % 3] - c[k];
      least = std::min(least, std::atan2(twice, glm::dot(a, b)));
      longest = std::max(longest, glm::length(a));
      shortest = std::min(shortest, glm::length(a));
    }
    found.degenerate += collapsed[t] || !(0.5 * twice > 1e-9 * longest * longest);
    found.longest_edge = std::max(found.longest_edge, longest);
    angles.push_back(twice > 0 ? least / degrees : 0.0);
  }
  found.shortest_edge = shortest;
  constexpr std::array<double, 5> sliver_limits{1, 5, 10, 20, 30};
  for (const double a : angles)
    for (std::size_t k = 0; k < sliver_limits.size(); ++k) found.slivers[k] += a < sliver_limits[k];
  std::sort(angles.begin(), angles.end());
  constexpr std::array<double, 4> shares{0, 0.01, 0.05, 0.5};
  for (std::size_t k = 0; k < shares.size(); ++k)
    found.least_angle_deg[k] = angles[static_cast<std::size_t>(shares[k] * static_cast<double>(angles.size() - 1))];

  // Edges: sorted half edges, the lesser place first.
  struct HalfEdge {
    Index a, b, corner;  // corner: 3 * triangle + which, the edge runs from it to the next
  };
  std::vector<HalfEdge> half;
  half.reserve(3 * triangles.size());
  std::vector<std::uint8_t> used(places, 0);
  for (Index t = 0; t < triangles.size(); ++t) {
    if (collapsed[t]) continue;
    for (Index k = 0; k < 3; ++k) {
      const Index a = placed[t][static_cast<int>(k)], b = placed[t][static_cast<int>((k + 1) % 3)];
      half.push_back({std::min(a, b), std::max(a, b), 3 * t + k});
      used[a] = 1;
    }
  }
  std::sort(half.begin(), half.end(), [](const HalfEdge& x, const HalfEdge& y) {
    return std::tie(x.a, x.b, x.corner) < std::tie(y.a, y.b, y.corner);
  });
  found.vertices = static_cast<std::size_t>(std::count(used.begin(), used.end(), 1));
  DisjointSets pieces(places), corners(3 * triangles.size()), loops(places);
  std::vector<std::uint8_t> on_border(places, 0);
  const auto normal = [&](Index t) {
    const dvec3 a(positions[triangles[t].x]), b(positions[triangles[t].y]), c(positions[triangles[t].z]);
    return glm::cross(b - a, c - a);
  };
  for (std::size_t i = 0; i < half.size();) {
    std::size_t j = i + 1;
    while (j < half.size() && half[j].a == half[i].a && half[j].b == half[i].b) ++j;
    ++found.edges;
    pieces.join(half[i].a, half[i].b);
    found.non_manifold_edges += j - i > 2;
    if (j - i == 1) {
      ++found.border_edges;
      on_border[half[i].a] = on_border[half[i].b] = 1;
      loops.join(half[i].a, half[i].b);
    }
    if (j - i == 2) {
      const Index x = half[i].corner, y = half[i + 1].corner;
      const bool same_way = placed[x / 3][static_cast<int>(x % 3)] == placed[y / 3][static_cast<int>(y % 3)];
      found.inconsistent_edges += same_way;
      const dvec3 n0 = normal(x / 3), n1 = normal(y / 3);
      if (!same_way && glm::length(n0) > 0 && glm::length(n1) > 0)
        found.sharpest_fold_deg =
            std::max(found.sharpest_fold_deg, std::atan2(glm::length(glm::cross(n0, n1)), glm::dot(n0, n1)) / degrees);
    }
    // The corners of all triangles at this edge belong to one fan around each of its ends.
    for (std::size_t k = i + 1; k < j; ++k)
      for (const Index end : {half[i].a, half[i].b}) {
        const auto corner_at = [&](Index corner) {
          const Index next = corner % 3 == 2 ? corner - 2 : corner + 1;
          return placed[corner / 3][static_cast<int>(corner % 3)] == end ? corner : next;
        };
        corners.join(corner_at(half[i].corner), corner_at(half[k].corner));
      }
    i = j;
  }
  std::vector<Index> fans(places, 0);
  for (Index c = 0; c < 3 * triangles.size(); ++c)
    if (!collapsed[c / 3] && corners.find(c) == c) ++fans[placed[c / 3][static_cast<int>(c % 3)]];
  for (Index v = 0; v < places; ++v) {
    found.non_manifold_vertices += fans[v] > 1;
    found.components += used[v] && pieces.find(v) == v;
    found.border_loops += on_border[v] && loops.find(v) == v;
  }
  const double euler = static_cast<double>(found.vertices) - static_cast<double>(found.edges) +
                       static_cast<double>(half.size() / 3) + static_cast<double>(found.border_loops);
  found.genus = static_cast<double>(found.components) - 0.5 * euler;
  if (intersections) find_intersections(positions, triangles, placed, found);
  return found;
}

std::vector<Ring> find_rings(const std::vector<vec3>& positions, const std::vector<uvec3>& triangles,
                             const std::vector<std::uint32_t>& place) {
  if (triangles.empty()) return {};
  const std::size_t places = *std::max_element(place.begin(), place.end()) + std::size_t{1};
  std::vector<dvec3> at(places);
  for (std::size_t i = 0; i < positions.size(); ++i) at[place[i]] = dvec3(positions[i]);
  struct Edge {
    Index a, b, left, right;
  };
  std::vector<Edge> edges;
  std::vector<std::vector<Index>> around(places);  // edges at each vertex
  std::unordered_map<std::uint64_t, Index> known;
  known.reserve(2 * triangles.size());
  for (Index t = 0; t < triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const Index a = place[triangles[t][k]], b = place[triangles[t][(k + 1) % 3]];
      const std::uint64_t key = (static_cast<std::uint64_t>(std::min(a, b)) << 32) | std::max(a, b);
      const auto [entry, fresh] = known.try_emplace(key, static_cast<Index>(edges.size()));
      if (!fresh) {
        edges[entry->second].right = t;
        continue;
      }
      edges.push_back({a, b, t, t});
      around[a].push_back(entry->second), around[b].push_back(entry->second);
    }
  const auto length = [&](const Edge& e) { return glm::length(at[e.a] - at[e.b]); };

  // The rings that paths from `root` leave over, as their vertices.
  const auto rings_from = [&](Index root) {
    std::vector<double> far(places, std::numeric_limits<double>::infinity());
    std::vector<Index> back(places, none);  // edge towards the root
    std::priority_queue<std::pair<double, Index>, std::vector<std::pair<double, Index>>, std::greater<>> queue;
    queue.emplace(far[root] = 0, root);
    while (!queue.empty()) {
      const auto [d, v] = queue.top();
      queue.pop();
      if (d > far[v]) continue;
      for (const Index e : around[v]) {
        const Index u = edges[e].a + edges[e].b - v;
        const double next = d + length(edges[e]);
        if (next < far[u]) back[u] = e, queue.emplace(far[u] = next, u);
      }
    }
    std::vector<std::pair<double, Index>> order;  // edges off the tree, longest detour first
    for (Index e = 0; e < edges.size(); ++e)
      if (back[edges[e].a] != e && back[edges[e].b] != e && std::isfinite(far[edges[e].a]))
        order.emplace_back(-(far[edges[e].a] + far[edges[e].b] + length(edges[e])), e);
    std::sort(order.begin(), order.end());
    DisjointSets faces(triangles.size());
    std::vector<std::vector<Index>> rings;
    for (const auto& [unused, e] : order) {
      if (faces.find(edges[e].left) != faces.find(edges[e].right)) {
        faces.join(edges[e].left, edges[e].right);
        continue;
      }
      // Both ways back to the root, without what they share.
      const auto way = [&](Index v) {
        std::vector<Index> path{v};
        while (v != root) path.push_back(v = edges[back[v]].a + edges[back[v]].b - v);
        return path;
      };
      std::vector<Index> one = way(edges[e].a), other = way(edges[e].b);
      Index last = root;
      while (!one.empty() && !other.empty() && one.back() == other.back())
        last = one.back(), one.pop_back(), other.pop_back();
      one.push_back(last);
      one.insert(one.end(), other.rbegin(), other.rend());
      rings.push_back(std::move(one));
    }
    return rings;
  };
  const auto measure = [&](const std::vector<Index>& vertices) {
    Ring ring;
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      const dvec3 a = at[vertices[i]], b = at[vertices[(i + 1) % vertices.size()]];
      ring.length += glm::length(a - b);
      ring.centre += glm::length(a - b) * 0.5 * (a + b);
    }
    ring.centre /= ring.length > 0 ? ring.length : 1;
    return ring;
  };
  std::vector<Ring> result;
  for (const std::vector<Index>& vertices : rings_from(place[triangles[0].x])) {
    Ring best = measure(vertices);
    for (const std::vector<Index>& again : rings_from(vertices[0]))
      if (std::find(again.begin(), again.end(), vertices[0]) != again.end())
        if (const Ring ring = measure(again); ring.length < best.length) best = ring;
    result.push_back(best);
    if (result.size() == 64) break;  // enough to mend
  }
  std::sort(result.begin(), result.end(), [](const Ring& a, const Ring& b) { return a.length < b.length; });
  return result;
}

AtlasChecks check_atlas(const Surface& s, int resolution) {
  AtlasChecks found;
  if (s.uvs.empty()) return found;
  check(s.uvs.size() == s.rest.size(), "check_atlas: one UV per vertex");
  check(resolution > 0 && resolution <= 1 << 14 && std::has_single_bit(static_cast<unsigned>(resolution)),
        "check_atlas: the resolution is a power of two up to 16384");
  constexpr std::int64_t one = std::int64_t{1} << 24;
  const std::int64_t texel = one / resolution;
  using Point = std::array<std::int64_t, 2>;
  std::vector<Point> at;
  for (const vec2& uv : s.uvs) {
    found.outside += !(uv.x >= 0 && uv.x <= 1 && uv.y >= 0 && uv.y <= 1);
    const auto fixed = [&](float v) {
      return std::isfinite(v) ? std::llround(glm::clamp(static_cast<double>(v), -8.0, 8.0) * one) : 0;
    };
    at.push_back({fixed(uv.x), fixed(uv.y)});
  }
  DisjointSets charts(s.rest.size());
  for (const uvec3& t : s.triangles) charts.join(t.x, t.y), charts.join(t.y, t.z);
  std::vector<std::uint8_t> used(s.rest.size(), 0);
  for (const uvec3& t : s.triangles) used[charts.find(t.x)] = 1;
  found.charts = static_cast<std::size_t>(std::count(used.begin(), used.end(), 1));

  const std::size_t n = static_cast<std::size_t>(resolution);
  found.texels = n * n;
  std::vector<Index> owner(n * n, none);
  std::vector<std::uint8_t> again(n * n, 0);
  std::vector<std::pair<double, double>> density, stretch;
  double area = 0;
  for (const uvec3& t : s.triangles) {
    std::array<Point, 3> p{at[t.x], at[t.y], at[t.z]};
    const auto edge = [](const Point& a, const Point& b, const Point& c) {
      return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    };
    const std::int64_t twice = edge(p[0], p[1], p[2]);
    const dvec3 a(s.rest[t.x]), b(s.rest[t.y]), c(s.rest[t.z]);
    const double surface = 0.5 * glm::length(glm::cross(b - a, c - a));
    if (twice == 0) {
      ++found.flat;
      continue;
    }
    found.mirrored += twice > 0;  // v runs down, so what is seen from the front turns the other way
    if (surface > 0) {
      const double flat = 0.5 * std::abs(static_cast<double>(twice)) / (static_cast<double>(one) * one);
      density.emplace_back(std::sqrt(flat / surface), surface);
      // Singular values of the map from the triangle's plane to the atlas.
      const dvec3 x = glm::normalize(b - a), y = glm::cross(glm::normalize(glm::cross(b - a, c - a)), x);
      const glm::dmat2 from(glm::length(b - a), 0, glm::dot(c - a, x), glm::dot(c - a, y));
      const glm::dmat2 to(dvec2(s.uvs[t.y] - s.uvs[t.x]), dvec2(s.uvs[t.z] - s.uvs[t.x]));
      const glm::dmat2 j = to * glm::inverse(from);
      const double e = 0.5 * (glm::dot(j[0], j[0]) + glm::dot(j[1], j[1])), det = std::abs(glm::determinant(j));
      const double large = std::sqrt(e + std::sqrt(std::max(e * e - det * det, 0.0)));
      stretch.emplace_back(large * large / det, surface);
      area += surface;
    }
    if (twice < 0) std::swap(p[1], p[2]);
    const auto range = [&](int axis) {
      const std::int64_t low = std::min({p[0][axis], p[1][axis], p[2][axis]}),
                         high = std::max({p[0][axis], p[1][axis], p[2][axis]});
      return std::pair(std::clamp<std::int64_t>(low / texel - 1, 0, resolution - 1),
                       std::clamp<std::int64_t>(high / texel + 1, 0, resolution - 1));
    };
    const auto [x0, x1] = range(0);
    const auto [y0, y1] = range(1);
    // A centre on an edge belongs to the triangle for which that edge is a top or a left one.
    std::array<std::int64_t, 3> bias{};
    for (int k = 0; k < 3; ++k) {
      const Point &u = p[k], &v = p[(k + 1) % 3];
      const bool owns = v[1] < u[1] || (v[1] == u[1] && v[0] > u[0]);
      bias[k] = owns ? 0 : -1;
    }
    const Index chart = charts.find(t.x);
    for (std::int64_t y = y0; y <= y1; ++y)
      for (std::int64_t x = x0; x <= x1; ++x) {
        const Point centre{x * texel + texel / 2, y * texel + texel / 2};
        bool inside = true;
        for (int k = 0; k < 3; ++k) inside &= edge(p[k], p[(k + 1) % 3], centre) + bias[k] >= 0;
        if (!inside) continue;
        const std::size_t i = static_cast<std::size_t>(y) * n + static_cast<std::size_t>(x);
        if (owner[i] != none) again[i] = 1;
        owner[i] = chart;
      }
  }
  for (std::size_t i = 0; i < n * n; ++i) found.covered += owner[i] != none, found.twice += again[i];
  if (const auto first = std::find(again.begin(), again.end(), std::uint8_t{1}); first != again.end()) {
    const std::size_t i = static_cast<std::size_t>(first - again.begin());
    found.first_twice = dvec2(static_cast<double>(i % n) + 0.5, static_cast<double>(i / n) + 0.5) / static_cast<double>(n);
  }
  const auto summarise = [&](std::vector<std::pair<double, double>>& values, std::array<double, 3>& out,
                             const std::array<double, 3>& shares) {
    std::sort(values.begin(), values.end());
    for (int k = 0; k < 3; ++k) out[k] = percentile(values, area, shares[k]);
  };
  summarise(density, found.density, {0.05, 0.5, 0.95});
  summarise(stretch, found.stretch, {0.5, 0.95, 0.99});

  constexpr int reach = 64;
  double nearest = reach;
  std::vector<std::pair<std::int32_t, std::int32_t>> border;  // covered texels beside others
  const auto cell = [&](int x, int y) { return owner[static_cast<std::size_t>(y) * n + x]; };
  for (int y = 0; y < resolution; ++y)
    for (int x = 0; x < resolution; ++x) {
      if (cell(x, y) == none) continue;
      bool edge = false;
      for (const auto& [dx, dy] : {std::pair(1, 0), std::pair(-1, 0), std::pair(0, 1), std::pair(0, -1)}) {
        const int u = x + dx, v = y + dy;
        edge |= u >= 0 && v >= 0 && u < resolution && v < resolution && cell(u, v) != cell(x, y);
      }
      if (edge) border.emplace_back(x, y);
    }
  for (const auto& [x, y] : border) {
    const int r = static_cast<int>(std::ceil(nearest));
    for (int v = std::max(0, y - r); v <= std::min(resolution - 1, y + r); ++v)
      for (int u = std::max(0, x - r); u <= std::min(resolution - 1, x + r); ++u) {
        const Index other = cell(u, v);
        if (other == none || other == cell(x, y)) continue;
        nearest = std::min(nearest, std::hypot(u - x, v - y));
      }
  }
  found.gutter_texels = nearest;
  return found;
}

}  // namespace moomill
