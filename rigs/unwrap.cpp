#include "rigs/unwrap.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <map>
#include <numeric>
#include <queue>
#include <set>
#include <tuple>
#include <unordered_map>

#include "generator/core/parallel.h"

namespace moomill {
namespace {

using Index = std::uint32_t;
constexpr int none = -1;
constexpr double least_facing = 0.45;  // cosine between a triangle and its chart: texels stretch at most 2.2 times

struct Faces {
  std::vector<dvec3> normal, centre;
  std::vector<double> area;
  std::vector<std::array<int, 3>> beside;  // across each edge; none at the border
};

Faces measure(const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles) {
  Faces f;
  const std::size_t n = triangles.size();
  f.normal.resize(n), f.centre.resize(n), f.area.resize(n);
  f.beside.assign(n, {none, none, none});
  std::unordered_map<std::uint64_t, std::size_t> edges;  // directed edge to 3 * triangle + corner
  edges.reserve(3 * n);
  for (std::size_t t = 0; t < n; ++t) {
    const uvec3& v = triangles[t];
    const dvec3 a = positions[v.x], b = positions[v.y], c = positions[v.z], cross = glm::cross(b - a, c - a);
    f.area[t] = 0.5 * glm::length(cross);
    f.normal[t] = f.area[t] > 0 ? glm::normalize(cross) : dvec3(0, 0, 1);
    f.centre[t] = (a + b + c) / 3.0;
    for (int k = 0; k < 3; ++k) edges[(static_cast<std::uint64_t>(v[k]) << 32) | v[(k + 1) % 3]] = 3 * t + k;
  }
  for (std::size_t t = 0; t < n; ++t)
    for (int k = 0; k < 3; ++k) {
      const auto twin = edges.find((static_cast<std::uint64_t>(triangles[t][(k + 1) % 3]) << 32) | triangles[t][k]);
      if (twin != edges.end()) f.beside[t][k] = static_cast<int>(twin->second / 3);
    }
  return f;
}

struct Proxy {
  dvec3 normal{0}, centre{0};
  int seed = 0;
};

// Grows charts from their seeds, best fitting triangle first; what no chart can take seeds new ones.
std::vector<int> grow(const Faces& f, std::vector<Proxy>& proxies) {
  std::vector<int> chart(f.normal.size(), none);
  using Entry = std::tuple<double, int, int>;  // cost, triangle, chart
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  const auto cost = [&](int t, int c) {
    return 1 - glm::dot(f.normal[t], proxies[c].normal) + 0.15 * glm::length(f.centre[t] - proxies[c].centre);
  };
  const auto flood = [&] {
    while (!queue.empty()) {
      const auto [unused, t, c] = queue.top();
      queue.pop();
      if (chart[t] != none) continue;
      chart[t] = c;
      for (const int u : f.beside[t])
        if (u != none && chart[u] == none && glm::dot(f.normal[u], proxies[c].normal) > least_facing)
          queue.emplace(cost(u, c), u, c);
    }
  };
  for (std::size_t c = 0; c < proxies.size(); ++c) queue.emplace(-1.0, proxies[c].seed, static_cast<int>(c));
  flood();
  for (std::size_t t = 0; t < chart.size(); ++t) {
    if (chart[t] != none) continue;
    proxies.push_back({f.normal[t], f.centre[t], static_cast<int>(t)});
    queue.emplace(0.0, static_cast<int>(t), static_cast<int>(proxies.size()) - 1);
    flood();
  }
  return chart;
}

void refit(const Faces& f, const std::vector<int>& chart, std::vector<Proxy>& proxies) {
  std::vector<dvec3> normal(proxies.size(), dvec3(0)), centre(proxies.size(), dvec3(0));
  std::vector<double> area(proxies.size(), 0.0), best(proxies.size(), std::numeric_limits<double>::infinity());
  for (std::size_t t = 0; t < chart.size(); ++t) {
    normal[chart[t]] += f.area[t] * f.normal[t];
    centre[chart[t]] += f.area[t] * f.centre[t];
    area[chart[t]] += f.area[t];
  }
  std::vector<int> seed(proxies.size(), none);
  for (std::size_t c = 0; c < proxies.size(); ++c)
    if (area[c] > 0 && glm::length(normal[c]) > 0) normal[c] = glm::normalize(normal[c]), centre[c] /= area[c];
  for (std::size_t t = 0; t < chart.size(); ++t) {
    const int c = chart[t];
    const double misfit = 1 - glm::dot(f.normal[t], normal[c]) + glm::length(f.centre[t] - centre[c]);
    if (misfit < best[c]) best[c] = misfit, seed[c] = static_cast<int>(t);
  }
  std::vector<Proxy> fitted;
  // Very small charts are given up; their neighbours may be able to take their triangles now.
  const double total = std::accumulate(area.begin(), area.end(), 0.0);
  for (std::size_t c = 0; c < proxies.size(); ++c)
    if (seed[c] != none && area[c] > 3e-4 * total) fitted.push_back({normal[c], centre[c], seed[c]});
  proxies = std::move(fitted);
}

// A triangle with two neighbours in another chart joins it: shorter, smoother seams.
void smooth_borders(const Faces& f, const std::vector<Proxy>& proxies, std::vector<int>& chart) {
  for (int sweep = 0; sweep < 4; ++sweep)
    for (std::size_t t = 0; t < chart.size(); ++t)
      for (int k = 0; k < 3; ++k) {
        const int a = f.beside[t][k], b = f.beside[t][(k + 1) % 3];
        if (a == none || b == none || chart[a] != chart[b] || chart[a] == chart[t]) continue;
        if (glm::dot(f.normal[t], proxies[chart[a]].normal) > least_facing) chart[t] = chart[a];
      }
}

std::vector<std::vector<Index>> components(const Faces& f, const std::vector<int>& chart) {
  std::vector<std::vector<Index>> result;
  std::vector<std::uint8_t> seen(chart.size(), 0);
  for (std::size_t t = 0; t < chart.size(); ++t) {
    if (seen[t]) continue;
    std::vector<Index> part{static_cast<Index>(t)};
    seen[t] = 1;
    for (std::size_t i = 0; i < part.size(); ++i)
      for (const int u : f.beside[part[i]])
        if (u != none && !seen[u] && chart[u] == chart[t]) seen[u] = 1, part.push_back(static_cast<Index>(u));
    result.push_back(std::move(part));
  }
  return result;
}

Chart flatten(const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles, const Faces& f,
              std::vector<Index> part) {
  Chart chart;
  dvec3 normal(0);
  for (const Index t : part) {
    normal += f.area[t] * f.normal[t];
    for (int k = 0; k < 3; ++k) chart.vertices.push_back(triangles[t][k]);
  }
  normal = glm::normalize(normal);
  std::sort(chart.vertices.begin(), chart.vertices.end());
  chart.vertices.erase(std::unique(chart.vertices.begin(), chart.vertices.end()), chart.vertices.end());
  const dvec3 helper = std::abs(normal.z) < 0.9 ? dvec3(0, 0, 1) : dvec3(1, 0, 0);
  const dvec3 right = glm::normalize(glm::cross(helper, normal)), up = glm::cross(normal, right);
  for (const Index v : chart.vertices)
    chart.flat.emplace_back(glm::dot(positions[v], right), glm::dot(positions[v], up));
  std::sort(part.begin(), part.end());
  chart.triangles = std::move(part);
  return chart;
}

// Two halves, by which of two far ends a triangle is nearer to over the surface.
std::array<std::vector<Index>, 2> halve(const Faces& f, const std::vector<Index>& part) {
  std::unordered_map<Index, int> slot;
  for (std::size_t i = 0; i < part.size(); ++i) slot[part[i]] = static_cast<int>(i);
  const auto distances = [&](int start) {
    std::vector<double> d(part.size(), std::numeric_limits<double>::infinity());
    std::priority_queue<std::pair<double, int>, std::vector<std::pair<double, int>>, std::greater<>> queue;
    queue.emplace(d[start] = 0, start);
    while (!queue.empty()) {
      const auto [far, i] = queue.top();
      queue.pop();
      if (far > d[i]) continue;
      for (const int u : f.beside[part[i]]) {
        const auto j = u == none ? slot.end() : slot.find(static_cast<Index>(u));
        if (j == slot.end()) continue;
        const double next = far + glm::length(f.centre[part[i]] - f.centre[u]);
        if (next < d[j->second]) queue.emplace(d[j->second] = next, j->second);
      }
    }
    return d;
  };
  const auto farthest = [](const std::vector<double>& d) {
    return static_cast<int>(std::max_element(d.begin(), d.end()) - d.begin());
  };
  const int a = farthest(distances(0));
  const std::vector<double> from_a = distances(a);
  const std::vector<double> from_b = distances(farthest(from_a));
  std::array<std::vector<Index>, 2> halves;
  for (std::size_t i = 0; i < part.size(); ++i) halves[from_a[i] <= from_b[i] ? 0 : 1].push_back(part[i]);
  return halves;
}

// Would the union of these triangles do as a chart? With it in `chart`, flattened.
bool flattens(Chart& chart, const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles, int rounds,
              double worst, double uneven) {
  flatten_rigidly(chart, positions, triangles, rounds);
  const Stretch stretch = measure_stretch(chart, positions, triangles);
  return !stretch.turned_over && stretch.worst < worst && stretch.uneven < uneven &&
         !border_crosses(chart, triangles);
}

// Share of its smallest bounding rectangle that a chart fills: sprawling charts cannot be packed.
double filling(const Chart& chart, double area) {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < 18; ++i) {
    const double c = std::cos(i * 5 * degrees), s = std::sin(i * 5 * degrees);
    dvec2 lower(std::numeric_limits<double>::infinity()), upper = -lower;
    for (const dvec2& p : chart.flat) {
      const dvec2 q(c * p.x - s * p.y, s * p.x + c * p.y);
      lower = glm::min(lower, q), upper = glm::max(upper, q);
    }
    least = std::min(least, (upper.x - lower.x) * (upper.y - lower.y));
  }
  return area / least;
}

// Both charts in one, the second moved to where their common vertices fit best. Flat positions of these are means.
Chart united(const Chart& a, const Chart& b) {
  std::vector<std::pair<std::size_t, std::size_t>> common;
  for (std::size_t i = 0, j = 0; i < a.vertices.size() && j < b.vertices.size();) {
    if (a.vertices[i] == b.vertices[j])
      common.emplace_back(i++, j++);
    else
      ++(a.vertices[i] < b.vertices[j] ? i : j);
  }
  dvec2 middle_a(0), middle_b(0);
  for (const auto& [i, j] : common) middle_a += a.flat[i], middle_b += b.flat[j];
  middle_a /= static_cast<double>(common.size()), middle_b /= static_cast<double>(common.size());
  double c = 0, s = 0;
  for (const auto& [i, j] : common) {
    const dvec2 p = b.flat[j] - middle_b, q = a.flat[i] - middle_a;
    c += glm::dot(p, q), s += p.x * q.y - p.y * q.x;
  }
  const double length = std::hypot(c, s);
  c = length > 0 ? c / length : 1, s = length > 0 ? s / length : 0;
  Chart chart;
  std::merge(a.triangles.begin(), a.triangles.end(), b.triangles.begin(), b.triangles.end(),
             std::back_inserter(chart.triangles));
  for (std::size_t i = 0, j = 0; i < a.vertices.size() || j < b.vertices.size();) {
    const bool from_a = j == b.vertices.size() || (i < a.vertices.size() && a.vertices[i] <= b.vertices[j]);
    const bool from_b = i == a.vertices.size() || (j < b.vertices.size() && b.vertices[j] <= a.vertices[i]);
    chart.vertices.push_back(from_a ? a.vertices[i] : b.vertices[j]);
    dvec2 place(0);
    if (from_b) {
      const dvec2 p = b.flat[j] - middle_b;
      place = middle_a + dvec2(c * p.x - s * p.y, s * p.x + c * p.y);
    }
    if (from_a) place = from_b ? 0.5 * (place + a.flat[i]) : a.flat[i];
    chart.flat.push_back(place);
    i += from_a, j += from_b;
  }
  return chart;
}

// Merges neighbours while that keeps stretch low: in every round the best partners of all charts at once.
void merge_charts(const Faces& f, const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles,
                  std::vector<Chart>& charts) {
  constexpr double largest = 0.25, fullest = 0.62;  // share of the whole surface; of the bounding rectangle
  std::vector<int> owner(triangles.size());
  std::vector<double> area(charts.size(), 0.0);
  std::set<std::pair<int, int>> refused;
  for (std::size_t c = 0; c < charts.size(); ++c)
    for (const Index t : charts[c].triangles) owner[t] = static_cast<int>(c), area[c] += f.area[t];
  const double total = std::accumulate(area.begin(), area.end(), 0.0);
  while (true) {
    std::map<std::pair<int, int>, double> shared;  // length of the seam, visible parts counted more
    std::vector<double> around(charts.size(), 0.0);
    for (std::size_t t = 0; t < triangles.size(); ++t)
      for (int k = 0; k < 3; ++k) {
        const int u = f.beside[t][k];
        if (u != none && owner[u] == owner[t]) continue;
        const double length = glm::length(positions[triangles[t][k]] - positions[triangles[t][(k + 1) % 3]]);
        around[owner[t]] += length;
        const dvec3& n = f.normal[t];
        if (u != none)
          shared[std::minmax(owner[t], owner[u])] += length * (0.5 + std::max(n.y, 0.0) + 0.5 * std::max(n.z, 0.0));
      }
    struct Candidate {
      double gain;
      int a, b;
    };
    std::vector<Candidate> candidates;
    for (const auto& [pair, length] : shared) {
      const auto [a, b] = pair;
      if (area[a] + area[b] > largest * total || refused.count(pair)) continue;
      candidates.push_back({length / std::min(around[a], around[b]), a, b});
    }
    std::stable_sort(candidates.begin(), candidates.end(),
                     [](const Candidate& x, const Candidate& y) { return x.gain > y.gain; });
    std::vector<std::uint8_t> taken(charts.size(), 0);
    std::vector<Candidate> tried;
    for (const Candidate& c : candidates) {
      if (taken[c.a] || taken[c.b]) continue;
      taken[c.a] = taken[c.b] = 1;
      tried.push_back(c);
    }
    if (tried.empty()) break;
    std::vector<Chart> unions(tried.size());
    std::vector<std::uint8_t> good(tried.size(), 0);
    parallel_for(tried.size(), 1, [&](std::size_t i) {
      unions[i] = united(charts[tried[i].a], charts[tried[i].b]);
      good[i] = filling(unions[i], area[tried[i].a] + area[tried[i].b]) > fullest &&
                flattens(unions[i], positions, triangles, 10, 1.6, 0.03);
    });
    for (std::size_t i = 0; i < tried.size(); ++i) {
      const auto [gain, a, b] = tried[i];
      if (!good[i]) {
        refused.insert(std::minmax(a, b));
        continue;
      }
      // A chart that changed is a new one to all its neighbours.
      std::erase_if(refused, [&](const std::pair<int, int>& p) {
        return p.first == a || p.second == a || p.first == b || p.second == b;
      });
      for (const Index t : charts[b].triangles) owner[t] = a;
      area[a] += area[b], area[b] = 0;
      charts[a] = std::move(unions[i]);
      charts[b] = {};
    }
  }
  std::erase_if(charts, [](const Chart& c) { return c.triangles.empty(); });
}

}  // namespace

std::vector<Chart> cut_charts(const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles) {
  const Faces f = measure(positions, triangles);
  std::vector<Proxy> proxies;
  std::vector<int> label = grow(f, proxies);
  for (int round = 0; round < 4; ++round) {
    refit(f, label, proxies);
    label = grow(f, proxies);
  }
  smooth_borders(f, proxies, label);
  std::vector<std::vector<Index>> work = components(f, label);
  std::vector<Chart> charts;
  while (!work.empty()) {
    std::vector<Index> part = std::move(work.back());
    work.pop_back();
    Chart chart = flatten(positions, triangles, f, part);
    if (part.size() > 1 && !flattens(chart, positions, triangles, 4, 2.0, 0.1)) {
      auto halves = halve(f, part);
      // A half may fall apart where it is nearer to one end along two ways.
      std::vector<int> side(triangles.size(), none);
      for (int h = 0; h < 2; ++h)
        for (const Index t : halves[h]) side[t] = h;
      for (auto& piece : components(f, side))
        if (side[piece[0]] != none) work.push_back(std::move(piece));
      continue;
    }
    charts.push_back(std::move(chart));
  }
  merge_charts(f, positions, triangles, charts);
  return charts;
}

}  // namespace moomill
