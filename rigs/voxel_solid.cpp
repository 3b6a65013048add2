#include "rigs/voxel_solid.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <queue>

#include "generator/core/topology.h"

namespace moomill {
namespace {

// Whether a triangle (relative to the centre of a cube) reaches into the cube of half width h: separating axes
// (Akenine-Moeller 2001). Touching counts.
bool overlaps(const std::array<dvec3, 3>& v, double h) {
  for (int a = 0; a < 3; ++a) {
    if (std::min({v[0][a], v[1][a], v[2][a]}) > h || std::max({v[0][a], v[1][a], v[2][a]}) < -h) return false;
  }
  const std::array<dvec3, 3> edge{v[1] - v[0], v[2] - v[1], v[0] - v[2]};
  const dvec3 n = glm::cross(edge[0], edge[1]);
  if (std::abs(glm::dot(n, v[0])) > h * (std::abs(n.x) + std::abs(n.y) + std::abs(n.z))) return false;
  for (const dvec3& e : edge)
    for (int a = 0; a < 3; ++a) {
      dvec3 unit(0);
      unit[a] = 1;
      const dvec3 axis = glm::cross(unit, e);
      const double p0 = glm::dot(axis, v[0]), p1 = glm::dot(axis, v[1]), p2 = glm::dot(axis, v[2]);
      const double r = h * (std::abs(axis.x) + std::abs(axis.y) + std::abs(axis.z));
      if (std::min({p0, p1, p2}) > r || std::max({p0, p1, p2}) < -r) return false;
    }
  return true;
}

// Fans of triangles over the loops of the open border. A branching border is walked edge by edge; what does not come
// back to its start is closed by the fan all the same.
void cap_borders(std::vector<dvec3>& positions, std::vector<uvec3>& triangles) {
  const std::vector<std::uint32_t> id = weld(positions);
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> uses;
  for (const uvec3& t : triangles)
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t a = id[t[k]], b = id[t[(k + 1) % 3]];
      if (a != b) ++uses[std::minmax(a, b)];
    }
  std::map<std::uint32_t, std::vector<std::uint32_t>> border;
  for (const auto& [edge, count] : uses)
    if (count == 1) {
      border[edge.first].push_back(edge.second);
      border[edge.second].push_back(edge.first);
    }
  std::vector<dvec3> place(positions.size());
  for (std::size_t i = 0; i < id.size(); ++i) place[id[i]] = positions[i];
  const auto take = [&](std::uint32_t from, std::uint32_t to) {
    auto& list = border[from];
    list.erase(std::find(list.begin(), list.end(), to));
  };
  for (auto& [start, ends] : border)
    while (!ends.empty()) {
      std::vector<std::uint32_t> loop{start};
      while (!border[loop.back()].empty() && (loop.size() == 1 || loop.back() != start)) {
        const std::uint32_t from = loop.back(), to = border[from].front();
        take(from, to);
        take(to, from);
        loop.push_back(to);
      }
      dvec3 centre(0);
      for (const std::uint32_t v : loop) centre += place[v];
      const std::uint32_t middle = static_cast<std::uint32_t>(positions.size());
      positions.push_back(centre / static_cast<double>(loop.size()));
      for (const std::uint32_t v : loop) positions.push_back(place[v]);
      for (std::uint32_t k = 0; k < loop.size(); ++k)
        triangles.emplace_back(middle, middle + 1 + k, middle + 1 + (k + 1) % static_cast<std::uint32_t>(loop.size()));
    }
}

struct Grid {
  std::array<int, 3> n{};
  std::size_t count() const { return static_cast<std::size_t>(n[0]) * n[1] * n[2]; }
  std::size_t at(int x, int y, int z) const { return (static_cast<std::size_t>(z) * n[1] + y) * n[0] + x; }
  std::array<int, 3> split(std::size_t i) const {
    return {static_cast<int>(i % n[0]), static_cast<int>(i / n[0] % n[1]),
            static_cast<int>(i / (static_cast<std::size_t>(n[0]) * n[1]))};
  }
  // Place of the neighbour on side 0..5 (-x, +x, ...), or count() outside.
  std::size_t beside(std::size_t i, int side) const {
    std::array<int, 3> p = split(i);
    p[side / 2] += side % 2 ? 1 : -1;
    if (p[side / 2] < 0 || p[side / 2] >= n[side / 2]) return count();
    return at(p[0], p[1], p[2]);
  }
};

// Everything that can be reached from the corner of the grid without entering `wall`.
std::vector<std::uint8_t> flood(const Grid& grid, const std::vector<std::uint8_t>& wall) {
  std::vector<std::uint8_t> reached(wall.size(), 0);
  std::vector<std::size_t> stack{0};
  reached[0] = 1;
  while (!stack.empty()) {
    const std::size_t i = stack.back();
    stack.pop_back();
    for (int side = 0; side < 6; ++side) {
      const std::size_t j = grid.beside(i, side);
      if (j == grid.count() || reached[j] || wall[j]) continue;
      reached[j] = 1;
      stack.push_back(j);
    }
  }
  return reached;
}

// `steps` rounds of growth by one cell into what is free.
void grow(const Grid& grid, std::vector<std::uint8_t>& set, const std::vector<std::uint8_t>* blocked, int steps) {
  std::vector<std::size_t> front;
  for (std::size_t i = 0; i < set.size(); ++i)
    if (set[i]) front.push_back(i);
  for (int s = 0; s < steps; ++s) {
    std::vector<std::size_t> next;
    for (const std::size_t i : front)
      for (int side = 0; side < 6; ++side) {
        const std::size_t j = grid.beside(i, side);
        if (j == grid.count() || set[j] || (blocked && (*blocked)[j])) continue;
        set[j] = 1;
        next.push_back(j);
      }
    front.swap(next);
  }
}

// What lies behind the surface when gaps up to twice `steps` cells are closed.
std::vector<std::uint8_t> inside_of(const Grid& grid, const std::vector<std::uint8_t>& surface, int steps) {
  std::vector<std::uint8_t> wall = surface;
  grow(grid, wall, nullptr, steps);
  std::vector<std::uint8_t> outside = flood(grid, wall);
  grow(grid, outside, &surface, steps);
  std::vector<std::uint8_t> inside(surface.size());
  for (std::size_t i = 0; i < inside.size(); ++i) inside[i] = !outside[i] && !surface[i];
  return inside;
}

// Carries the nearest source along the links (each cell hands its source to its neighbours): Euclidean distances
// wherever the straight line stays inside.
struct Carried {
  double key;
  std::int32_t cell, source;
  bool operator>(const Carried& o) const { return key != o.key ? key > o.key : cell != o.cell ? cell > o.cell : source > o.source; }
};
using CarriedQueue = std::priority_queue<Carried, std::vector<Carried>, std::greater<>>;

void measure_thickness(VoxelSolid& solid) {
  const std::size_t n = solid.places.size();
  std::vector<double> depth(n, -1);
  CarriedQueue queue;
  for (std::size_t i = 0; i < n; ++i)
    if (solid.on_surface[i]) queue.push({0.5 * solid.cell, static_cast<std::int32_t>(i), static_cast<std::int32_t>(i)});
  while (!queue.empty()) {
    const Carried c = queue.top();
    queue.pop();
    if (depth[c.cell] >= 0) continue;
    depth[c.cell] = c.key;
    for (const std::int32_t j : solid.near[c.cell])
      if (j >= 0 && depth[j] < 0)
        queue.push({0.5 * solid.cell + glm::length(solid.centre(j) - solid.centre(c.source)), j, c.source});
  }
  // The largest balls first; each claims what it covers.
  solid.thickness.assign(n, -1.0f);
  for (std::size_t i = 0; i < n; ++i) {
    bool peak = true;  // smaller balls beside larger ones are nearly covered by them
    for (const std::int32_t j : solid.near[i])
      if (j >= 0 && depth[j] > depth[i] + 0.5 * solid.cell) peak = false;
    if (peak) queue.push({-depth[i], static_cast<std::int32_t>(i), static_cast<std::int32_t>(i)});
  }
  while (!queue.empty()) {
    const Carried c = queue.top();
    queue.pop();
    if (solid.thickness[c.cell] >= 0) continue;
    solid.thickness[c.cell] = static_cast<float>(-c.key);
    for (const std::int32_t j : solid.near[c.cell])
      if (j >= 0 && solid.thickness[j] < 0 &&
          glm::length(solid.centre(j) - solid.centre(c.source)) <= -c.key + 0.5 * solid.cell)
        queue.push({c.key, j, c.source});
  }
  for (std::size_t i = 0; i < n; ++i)
    if (solid.thickness[i] < 0) solid.thickness[i] = static_cast<float>(depth[i]);
}

}  // namespace

dvec3 VoxelSolid::centre(std::size_t i) const {
  const std::uint32_t p = places[i];
  const std::uint32_t nx = static_cast<std::uint32_t>(size[0]), ny = static_cast<std::uint32_t>(size[1]);
  return lower + cell * (dvec3(p % nx, p / nx % ny, p / (nx * ny)) + 0.5);
}

int VoxelSolid::find(const dvec3& p, double reach) const {
  const dvec3 q = (p - lower) / cell;
  std::array<int, 3> c;
  for (int a = 0; a < 3; ++a) c[a] = static_cast<int>(std::floor(std::clamp(q[a], -1e6, 1e6)));
  const auto at = [&](int x, int y, int z) -> int {
    if (x < 0 || y < 0 || z < 0 || x >= size[0] || y >= size[1] || z >= size[2]) return -1;
    return index[(static_cast<std::size_t>(z) * size[1] + y) * size[0] + x];
  };
  if (const int own = at(c[0], c[1], c[2]); own >= 0) return own;
  const int most = static_cast<int>(std::ceil(reach / cell)) + 1;
  int best = -1;
  double best_distance = reach + 0.87 * cell;  // half a diagonal: the point may touch the far side of the cell
  for (int ring = 1; ring <= most; ++ring) {
    if ((ring - 1) * cell > best_distance) break;
    for (int z = -ring; z <= ring; ++z)
      for (int y = -ring; y <= ring; ++y)
        for (int x = -ring; x <= ring; x += (std::abs(z) == ring || std::abs(y) == ring) ? 1 : 2 * ring) {
          const int i = at(c[0] + x, c[1] + y, c[2] + z);
          if (i < 0) continue;
          const double d = glm::length(centre(i) - p);
          if (d < best_distance) best = i, best_distance = d;
        }
  }
  return best;
}

std::size_t VoxelSolid::enclosed() const {
  return static_cast<std::size_t>(std::count(on_surface.begin(), on_surface.end(), 0));
}

VoxelSolid voxelise(const std::vector<dvec3>& given_positions, const std::vector<uvec3>& given_triangles, double cell) {
  std::vector<dvec3> positions = given_positions;
  std::vector<uvec3> triangles = given_triangles;
  cap_borders(positions, triangles);

  Box box;
  for (const uvec3& t : triangles)
    for (int k = 0; k < 3; ++k) box.add(positions[t[k]]);
  VoxelSolid solid;
  solid.cell = cell;
  if (box.empty()) return solid;
  // The middle of a cell on y = 0, so that a symmetric animal has a symmetric grid.
  const int margin = 6;  // more than gaps are closed by, so that the outside is one piece
  Grid grid;
  for (int a = 0; a < 3; ++a) {
    const double first = std::floor(box.lower[a] / cell + 0.5) - margin;
    solid.lower[a] = (first - 0.5) * cell;
    grid.n[a] = static_cast<int>(std::floor(box.upper[a] / cell + 0.5) - first) + 1 + margin;
  }
  solid.size = grid.n;

  // Cells the surface passes through, and across which of their faces it goes on. A triangle that reaches into two
  // neighbouring cells crosses the face they share, for both it and their union are convex.
  std::vector<std::uint8_t> surface(grid.count(), 0), crossed(grid.count(), 0);  // crossed: bit a for the face towards +a
  for (const uvec3& t : triangles) {
    Box reach;
    for (int k = 0; k < 3; ++k) reach.add(positions[t[k]]);
    std::array<int, 3> lo, hi;
    for (int a = 0; a < 3; ++a) {
      lo[a] = std::max(0, static_cast<int>(std::floor((reach.lower[a] - solid.lower[a]) / cell - 1e-9)));
      hi[a] = std::min(grid.n[a] - 1, static_cast<int>(std::floor((reach.upper[a] - solid.lower[a]) / cell + 1e-9)));
    }
    std::vector<std::size_t> touched;
    for (int z = lo[2]; z <= hi[2]; ++z)
      for (int y = lo[1]; y <= hi[1]; ++y)
        for (int x = lo[0]; x <= hi[0]; ++x) {
          const dvec3 c = solid.lower + cell * (dvec3(x, y, z) + 0.5);
          if (overlaps({positions[t.x] - c, positions[t.y] - c, positions[t.z] - c}, 0.5 * cell * (1 + 1e-9)))
            touched.push_back(grid.at(x, y, z));
        }
    for (const std::size_t i : touched) {
      surface[i] = 1;
      for (int a = 0; a < 3; ++a)
        if (std::binary_search(touched.begin(), touched.end(), grid.beside(i, 2 * a + 1)))
          crossed[i] |= static_cast<std::uint8_t>(1 << a);
    }
  }

  // As little closing as finds most of what more closing would.
  std::vector<std::uint8_t> inside;
  {
    constexpr std::array<int, 4> steps{0, 1, 2, 4};
    std::array<std::vector<std::uint8_t>, 4> found;
    std::array<std::size_t, 4> count{};
    for (std::size_t k = 0; k < steps.size(); ++k) {
      found[k] = inside_of(grid, surface, steps[k]);
      count[k] = static_cast<std::size_t>(std::count(found[k].begin(), found[k].end(), 1));
    }
    // Closing also fills clefts between neighbouring limbs; only an inside that is missing altogether is worth that.
    const std::size_t most = *std::max_element(count.begin(), count.end());
    std::size_t k = 0;
    while (2 * count[k] < most) ++k;
    inside = std::move(found[k]);
    solid.closed_gap = 2 * steps[k] * cell;
  }

  solid.index.assign(grid.count(), -1);
  for (std::size_t i = 0; i < grid.count(); ++i)
    if (surface[i] || inside[i]) {
      solid.index[i] = static_cast<std::int32_t>(solid.places.size());
      solid.places.push_back(static_cast<std::uint32_t>(i));
      solid.on_surface.push_back(surface[i]);
    }
  solid.near.resize(solid.places.size());
  for (std::size_t c = 0; c < solid.places.size(); ++c)
    for (int side = 0; side < 6; ++side) {
      const std::size_t i = solid.places[c], j = grid.beside(i, side);
      std::int32_t& link = solid.near[c][side] = j == grid.count() ? -1 : solid.index[j];
      if (link >= 0 && surface[i] && surface[j]) {
        const std::size_t low = side % 2 ? i : j;
        if (!(crossed[low] >> (side / 2) & 1)) link = -1;
      }
    }
  measure_thickness(solid);
  return solid;
}

}  // namespace moomill
