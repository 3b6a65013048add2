#include "textures/hide.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <queue>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "generator/core/topology.h"
#include "textures/noise.h"

namespace moomill {
namespace {

constexpr std::size_t sample_count = 8192;

// Vertices of equal position are one here.
void weld_hide(Hide& hide) {
  const Surface& s = *hide.surface;
  hide.welded = weld(s.rest);
  for (std::size_t i = 0; i < s.rest.size(); ++i)
    if (hide.welded[i] == hide.positions.size()) hide.positions.push_back(s.rest[i] + 0.0f);
  hide.welded_count = hide.positions.size();
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;
  edges.reserve(6 * s.triangles.size());
  for (const uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = hide.welded[t[k]], b = hide.welded[t[(k + 1) % 3]];
      if (a != b) edges.push_back({a, b}), edges.push_back({b, a});
    }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  hide.neighbour_begin.assign(hide.welded_count + 1, 0);
  hide.neighbours.reserve(edges.size());
  for (const auto& [a, b] : edges) {
    ++hide.neighbour_begin[a + 1];
    hide.neighbours.push_back(b);
  }
  for (std::size_t i = 0; i < hide.welded_count; ++i) hide.neighbour_begin[i + 1] += hide.neighbour_begin[i];
}

std::span<const std::uint32_t> around(const Hide& hide, std::uint32_t vertex) {
  return {hide.neighbours.data() + hide.neighbour_begin[vertex],
          hide.neighbours.data() + hide.neighbour_begin[vertex + 1]};
}

double mean_edge(const Hide& hide) {
  double sum = 0;
  for (std::uint32_t v = 0; v < hide.welded_count; ++v)
    for (const std::uint32_t n : around(hide, v)) sum += glm::distance(hide.positions[v], hide.positions[n]);
  return hide.neighbours.empty() ? 0 : sum / static_cast<double>(hide.neighbours.size());
}

vec3 on_side(const vec3& left, float y) {
  return {left.x, y < 0 ? -left.y : left.y, left.z};
}

void lay_hair(Hide& hide) {
  const Surface& s = *hide.surface;
  std::vector<vec3> by_part(hide.part_names.size(), hide.hair.direction);
  for (std::size_t i = 0; i < by_part.size(); ++i)
    for (const auto& [part, direction] : hide.hair.parts)
      if (part_matches(part, hide.part_names[i])) by_part[i] = direction;
  std::vector<vec3> normal(hide.welded_count, vec3(0)), hair(hide.welded_count, vec3(0));
  for (std::size_t i = 0; i < s.rest.size(); ++i)
    if (i < s.normals.size()) normal[hide.welded[i]] += s.normals[i];
  for (std::size_t t = 0; t < s.triangles.size(); ++t) {
    const uvec3& v = s.triangles[t];
    const vec3 cross = glm::cross(s.rest[v.y] - s.rest[v.x], s.rest[v.z] - s.rest[v.x]);
    const vec3 left =
        t < s.parts.size() && s.parts[t] < by_part.size() ? by_part[s.parts[t]] : hide.hair.direction;
    const float y = (s.rest[v.x].y + s.rest[v.y].y + s.rest[v.z].y) / 3;
    for (int k = 0; k < 3; ++k) hair[hide.welded[v[k]]] += glm::length(cross) * on_side(left, y);
  }
  for (vec3& h : hair) {
    const float length = glm::length(h);
    h = length > 0 ? h / length : vec3(0);
  }
  // A step of averaging spreads by about 0.6 edges (standard deviation), so n steps by its square root.
  const double steps = std::pow(hide.hair.smoothing / (0.6 * std::max(mean_edge(hide), 1e-4)), 2);
  std::vector<vec3> next(hair.size());
  for (int step = 0; step < std::min(400, static_cast<int>(steps)); ++step) {
    parallel_for(hair.size(), 1024, [&](std::size_t v) {
      const auto ring = around(hide, static_cast<std::uint32_t>(v));
      vec3 sum(0);
      for (const std::uint32_t n : ring) sum += hair[n];
      next[v] = ring.empty() ? hair[v] : 0.5f * hair[v] + 0.5f * sum / static_cast<float>(ring.size());
    });
    hair.swap(next);
  }
  hide.normals.resize(s.rest.size());
  hide.hairs.resize(s.rest.size());
  for (std::size_t i = 0; i < s.rest.size(); ++i) {
    const std::uint32_t w = hide.welded[i];
    const float length = glm::length(normal[w]);
    const vec3 n = length > 0 ? normal[w] / length : vec3(0, 0, 1);
    const vec3 along = hair[w] - n * glm::dot(n, hair[w]);
    hide.normals[i] = n;
    // Where hair would stand on end (whorls) it is short: no direction is better than another.
    hide.hairs[i] = along / std::max(glm::length(along), 0.15f);
  }
}

void spread_samples(Hide& hide) {
  const Surface& s = *hide.surface;
  std::vector<double> until(s.triangles.size());
  for (std::size_t t = 0; t < s.triangles.size(); ++t) {
    const uvec3& v = s.triangles[t];
    hide.area += 0.5 * glm::length(glm::cross(dvec3(s.rest[v.y]) - dvec3(s.rest[v.x]),
                                              dvec3(s.rest[v.z]) - dvec3(s.rest[v.x])));
    until[t] = hide.area;
  }
  if (!(hide.area > 0)) return;
  for (std::size_t i = 0; i < sample_count; ++i) {
    const double at = (static_cast<double>(i) + 0.5) / sample_count * hide.area;
    const auto t = std::min<std::size_t>(std::upper_bound(until.begin(), until.end(), at) - until.begin(),
                                         until.size() - 1);
    const double r = std::sqrt(to_unit(mix64(2 * i))), q = to_unit(mix64(2 * i + 1));
    hide.samples.push_back({static_cast<std::uint32_t>(t), vec3(1 - r, r * (1 - q), r * q)});
  }
}

double distance_to_segment(const dvec3& p, const dvec3& a, const dvec3& b) {
  const dvec3 d = b - a;
  const double length2 = glm::dot(d, d);
  const double t = length2 > 0 ? std::clamp(glm::dot(p - a, d) / length2, 0.0, 1.0) : 0.0;
  return glm::length(p - a - t * d);
}

}  // namespace

bool part_matches(const std::string& pattern, const std::string& part) {
  if (pattern.ends_with('*')) return part.starts_with(std::string_view(pattern).substr(0, pattern.size() - 1));
  return pattern == part;
}

int Hide::pattern(const std::string& name) const {
  const auto found = std::find(patterns.begin(), patterns.end(), name);
  check(found != patterns.end(), "a part of the hide was not measured: call know_parts() before");
  return static_cast<int>(found - patterns.begin());
}

Hide make_hide(const Surface& surface, const std::vector<std::string>& part_names, const Hair& hair) {
  Hide hide;
  hide.surface = &surface;
  hide.part_names = part_names;
  hide.hair = hair;
  for (const uvec3& t : surface.triangles)
    for (int k = 0; k < 3; ++k) hide.box.add(dvec3(surface.rest[t[k]]));
  weld_hide(hide);
  lay_hair(hide);
  spread_samples(hide);
  return hide;
}

void know_part(Hide& hide, const std::string& pattern) {
  if (std::find(hide.patterns.begin(), hide.patterns.end(), pattern) != hide.patterns.end()) return;
  const Surface& s = *hide.surface;
  std::vector<std::uint8_t> matching(hide.part_names.size()), of_vertex(hide.welded_count, 0);  // bits: outside, inside
  for (std::size_t i = 0; i < matching.size(); ++i) matching[i] = part_matches(pattern, hide.part_names[i]);
  const auto in_part = [&](std::size_t t) {
    return t < s.parts.size() && s.parts[t] < matching.size() && matching[s.parts[t]];
  };
  // Edges between a triangle inside and one outside.
  std::vector<std::array<std::uint32_t, 3>> sides;  // two vertices, ascending, and whether inside
  for (std::size_t t = 0; t < s.triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = hide.welded[s.triangles[t][k]], b = hide.welded[s.triangles[t][(k + 1) % 3]];
      of_vertex[a] |= in_part(t) ? 2 : 1;
      if (a != b) sides.push_back({std::min(a, b), std::max(a, b), in_part(t)});
    }
  std::sort(sides.begin(), sides.end());
  std::vector<std::pair<std::uint32_t, std::uint32_t>> border;
  for (std::size_t i = 0; i + 1 < sides.size(); ++i)
    if (sides[i][0] == sides[i + 1][0] && sides[i][1] == sides[i + 1][1] && sides[i][2] != sides[i + 1][2])
      border.push_back({sides[i][0], sides[i][1]});

  // Nearest border edge of every vertex, handed on from neighbour to neighbour, nearest first.
  std::vector<float> inside(hide.welded_count);
  for (std::size_t v = 0; v < inside.size(); ++v) inside[v] = of_vertex[v] == 2 ? part_reach : -part_reach;
  constexpr std::uint32_t none = 0xffffffffu;
  std::vector<std::uint32_t> nearest(hide.welded_count, none);
  using Entry = std::tuple<double, std::uint32_t, std::uint32_t>;  // distance, vertex, edge
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  for (std::uint32_t e = 0; e < border.size(); ++e)
    queue.push({0.0, border[e].first, e}), queue.push({0.0, border[e].second, e});
  while (!queue.empty()) {
    const auto [distance, v, e] = queue.top();
    queue.pop();
    if (nearest[v] != none) continue;
    nearest[v] = e;
    if (distance > part_reach) continue;  // `inside` is clamped there
    inside[v] = static_cast<float>(of_vertex[v] == 2 ? distance : -distance);
    for (const std::uint32_t n : around(hide, v))
      if (nearest[n] == none)
        queue.push({distance_to_segment(dvec3(hide.positions[n]), dvec3(hide.positions[border[e].first]),
                                        dvec3(hide.positions[border[e].second])),
                    n, e});
  }
  // The border runs along edges; smoothing takes their zigzag out.
  const double reach = 4 * mean_edge(hide);
  std::vector<float> next(inside.size());
  for (int round = 0; round < 4; ++round) {
    for (std::uint32_t v = 0; v < inside.size(); ++v) {
      next[v] = inside[v];
      const auto ring = around(hide, v);
      if (std::abs(inside[v]) > reach || ring.empty()) continue;
      float sum = 0;
      for (const std::uint32_t n : ring) sum += inside[n];
      next[v] = 0.5f * inside[v] + 0.5f * sum / static_cast<float>(ring.size());
    }
    inside.swap(next);
  }
  std::vector<float> per_vertex(s.rest.size());
  float deepest = 0;
  for (std::size_t i = 0; i < per_vertex.size(); ++i) {
    per_vertex[i] = inside[hide.welded[i]];
    deepest = std::max(deepest, per_vertex[i]);
  }
  hide.patterns.push_back(pattern);
  hide.inside.push_back(std::move(per_vertex));
  hide.deepest.push_back(deepest);
}

PartFrame part_frame(const Hide& hide, const std::string& pattern) {
  const Surface& s = *hide.surface;
  std::vector<std::uint8_t> matching(hide.part_names.size());
  for (std::size_t i = 0; i < matching.size(); ++i) matching[i] = part_matches(pattern, hide.part_names[i]);
  const auto in_part = [&](std::size_t t) {
    return t < s.parts.size() && s.parts[t] < matching.size() && matching[s.parts[t]];
  };
  double area = 0, xx = 0, xz = 0, zz = 0;
  dvec3 mean(0);
  for (int pass = 0; pass < 2; ++pass) {
    for (std::size_t t = 0; t < s.triangles.size(); ++t) {
      if (!in_part(t)) continue;
      const dvec3 a(s.rest[s.triangles[t].x]), b(s.rest[s.triangles[t].y]), c(s.rest[s.triangles[t].z]);
      const double w = glm::length(glm::cross(b - a, c - a));
      const dvec3 p = (a + b + c) / 3.0;
      if (pass == 0) {
        area += w;
        mean += w * p;
      } else {
        const dvec3 d = p - mean;
        xx += w * d.x * d.x, xz += w * d.x * d.z, zz += w * d.z * d.z;
      }
    }
    if (!(area > 0)) return {};
    if (pass == 0) mean /= area;
  }
  const double angle = 0.5 * std::atan2(2 * xz, xx - zz);  // of the axis of most spread
  dvec3 along(std::cos(angle), 0, std::sin(angle));
  if (std::abs(along.x) < std::sin(20 * degrees) ? along.z < 0 : along.x < 0) along = -along;
  PartFrame f;
  f.axes = dmat3(along, dvec3(0, 1, 0), glm::cross(along, dvec3(0, 1, 0)));
  Box box;
  for (std::size_t t = 0; t < s.triangles.size(); ++t)
    if (in_part(t))
      for (int k = 0; k < 3; ++k) box.add(glm::transpose(f.axes) * dvec3(s.rest[s.triangles[t][k]]));
  f.centre = f.axes * box.centre();
  f.half = glm::max(0.5 * box.size(), dvec3(1e-4));
  return f;
}

HidePoint hide_point(const Hide& hide, std::uint32_t triangle, const dvec3& w, std::vector<float>& inside,
                     bool with_streak) {
  const Surface& s = *hide.surface;
  const uvec3& v = s.triangles[triangle];
  HidePoint p;
  p.at = w.x * dvec3(s.rest[v.x]) + w.y * dvec3(s.rest[v.y]) + w.z * dvec3(s.rest[v.z]);
  const vec3 f(w);
  const vec3 n = f.x * hide.normals[v.x] + f.y * hide.normals[v.y] + f.z * hide.normals[v.z];
  const float length = glm::length(n);
  p.normal = length > 1e-6f ? n / length : hide.normals[v.x];
  p.hair = f.x * hide.hairs[v.x] + f.y * hide.hairs[v.y] + f.z * hide.hairs[v.z];
  const float hair_length = glm::length(p.hair);
  if (hair_length > 1) p.hair /= hair_length;
  inside.resize(hide.patterns.size());
  for (std::size_t i = 0; i < inside.size(); ++i)
    inside[i] = f.x * hide.inside[i][v.x] + f.y * hide.inside[i][v.y] + f.z * hide.inside[i][v.z];
  p.inside = inside;
  if (with_streak) p.streak = hair_streak(hide.hair, p.at, p.hair);
  return p;
}

float hair_streak(const Hair& hair, const dvec3& at, const vec3& direction) {
  constexpr std::uint32_t key = 0x68a1u;
  constexpr std::array<double, 7> weight = {0.3, 0.7, 0.95, 1, 0.95, 0.7, 0.3};
  // Turned out of the axes, or hair that runs along one would meet the noise's lattice again and again.
  static const dmat3 turn(dvec3(0.36, 0.48, -0.8), dvec3(-0.8, 0.6, 0), dvec3(0.48, 0.64, 0.6));
  const dvec3 step = turn * dvec3(direction) * (hair.tuft_length / (6 * hair.tuft_width)),
              from = turn * at / hair.tuft_width;
  double sum = 0;
  for (int k = 0; k < 7; ++k) sum += weight[k] * gradient_noise(from + (k - 3.0) * step, key);
  return static_cast<float>(sum);
}

}  // namespace moomill
