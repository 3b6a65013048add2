#include "rigs/unwrap.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <queue>
#include <tuple>
#include <unordered_map>

#include "generator/core/error.h"

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

dvec2 flat_of(const Chart& chart, Index vertex) {
  return chart.flat[std::lower_bound(chart.vertices.begin(), chart.vertices.end(), vertex) - chart.vertices.begin()];
}

double cross2(const dvec2& a, const dvec2& b) {
  return a.x * b.y - a.y * b.x;
}

// True when some triangle is turned over or two triangles cover a point of a fine grid.
bool overlaps_itself(const Chart& chart, const std::vector<uvec3>& triangles) {
  dvec2 lower(1e30), upper(-1e30);
  for (const dvec2& p : chart.flat) lower = glm::min(lower, p), upper = glm::max(upper, p);
  constexpr int cells = 700;
  const double step = std::max(upper.x - lower.x, upper.y - lower.y) / cells;
  std::vector<std::uint8_t> covered(static_cast<std::size_t>(cells + 1) * (cells + 1), 0);
  for (const Index t : chart.triangles) {
    const dvec2 a = (flat_of(chart, triangles[t].x) - lower) / step,
                b = (flat_of(chart, triangles[t].y) - lower) / step,
                c = (flat_of(chart, triangles[t].z) - lower) / step;
    const double area = cross2(b - a, c - a);
    if (area <= 0) return true;
    const dvec2 from = glm::floor(glm::min(a, glm::min(b, c))), to = glm::max(a, glm::max(b, c));
    for (int y = std::max(0, static_cast<int>(from.y)); y <= std::min(cells, static_cast<int>(to.y)); ++y)
      for (int x = std::max(0, static_cast<int>(from.x)); x <= std::min(cells, static_cast<int>(to.x)); ++x) {
        const dvec2 p(x + 0.5, y + 0.5);
        const double eps = 1e-7 * area;
        if (cross2(b - a, p - a) <= eps || cross2(c - b, p - b) <= eps || cross2(a - c, p - c) <= eps) continue;
        if (covered[static_cast<std::size_t>(y) * (cells + 1) + x]++) return true;
      }
  }
  return false;
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

dvec2 turned(const dvec2& p, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * p.x - s * p.y, s * p.x + c * p.y};
}

// Turns a chart so that its bounding rectangle is smallest and lies flat, its lower corner at the origin.
dvec2 lay_flat(Chart& chart) {
  const auto extent = [&](double angle) {
    dvec2 lower(1e30), upper(-1e30);
    for (const dvec2& p : chart.flat) {
      const dvec2 q = turned(p, angle);
      lower = glm::min(lower, q), upper = glm::max(upper, q);
    }
    return std::pair(lower, upper);
  };
  double best = 0, least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < 36; ++i) {
    const auto [lower, upper] = extent(i * 5 * degrees);
    const double area =
        (upper.x - lower.x) * (upper.y - lower.y) * (upper.x >= upper.y - lower.y + lower.x ? 1.0 : 1.0001);
    if (area < least * 0.99999) least = area, best = i * 5 * degrees;
  }
  const auto [l, u] = extent(best);
  if (u.y - l.y > u.x - l.x) best += 90 * degrees;
  const auto [lower, upper] = extent(best);
  for (dvec2& p : chart.flat) p = turned(p, best) - lower;
  return upper - lower;
}

// Skyline packing: each rectangle goes where its top ends lowest. Returns the height used, or infinity.
double skyline(const std::vector<dvec2>& sizes, const std::vector<std::size_t>& order, std::vector<dvec2>* places) {
  struct Step {
    double x, y;
  };
  std::vector<Step> steps{{0, 0}};
  double top = 0;
  for (const std::size_t i : order) {
    const dvec2 s = sizes[i];
    double best = std::numeric_limits<double>::infinity();
    std::size_t at = 0;
    for (std::size_t k = 0; k < steps.size() && steps[k].x + s.x <= 1; ++k) {
      double y = 0;
      for (std::size_t j = k; j < steps.size() && steps[j].x < steps[k].x + s.x; ++j) y = std::max(y, steps[j].y);
      if (y + s.y < best) best = y + s.y, at = k;
    }
    if (!std::isfinite(best)) return best;
    const double x = steps[at].x, end = x + s.x;
    if (places) (*places)[i] = {x, best - s.y};
    double last = 0;
    std::size_t j = at;
    for (; j < steps.size() && steps[j].x < end; ++j) last = steps[j].y;
    const bool tail = (j == steps.size() ? 1.0 : steps[j].x) > end;
    steps.erase(steps.begin() + static_cast<std::ptrdiff_t>(at), steps.begin() + static_cast<std::ptrdiff_t>(j));
    steps.insert(steps.begin() + static_cast<std::ptrdiff_t>(at), {x, best});
    if (tail) steps.insert(steps.begin() + static_cast<std::ptrdiff_t>(at) + 1, {end, last});
    top = std::max(top, best);
  }
  return top;
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
    if (part.size() > 1 && overlaps_itself(chart, triangles)) {
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
  return charts;
}

void pack_charts(std::vector<Chart>& charts, double gutter) {
  std::vector<dvec2> sizes;
  for (Chart& chart : charts) sizes.push_back(lay_flat(chart));
  std::vector<std::size_t> order(charts.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return sizes[a].y > sizes[b].y; });
  const double inner = 1 - gutter;  // half a gutter at the atlas' own border
  const auto scaled = [&](double scale) {
    std::vector<dvec2> boxes;
    for (const dvec2& s : sizes) boxes.push_back((s * scale + gutter) / inner);
    return boxes;
  };
  double low = 0, high = 100;  // texture sides per metre; 0 always fits unless gutters alone fill the atlas
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (low + high);
    (skyline(scaled(middle), order, nullptr) <= 1 ? low : high) = middle;
  }
  if (low == 0) input_error("{} UV charts do not fit with a gutter of {}; lower it", charts.size(), gutter);
  std::vector<dvec2> places(charts.size());
  skyline(scaled(low), order, &places);
  for (std::size_t i = 0; i < charts.size(); ++i)
    for (dvec2& p : charts[i].flat) p = p * low + places[i] * inner + gutter;
}

}  // namespace moomill
