#include <array>
#include <cmath>
#include <unordered_map>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "rigs/remesh.h"

namespace moomill {
namespace {

constexpr int block = 2;         // lattice cells along a side of a block
constexpr int large_block = 16;  // and of those looked at first; a power of two times `block`

struct Lattice {
  dvec3 origin{0};
  double step = 0;
  int nx = 0, ny = 0, nz = 0;  // points
  std::vector<float> values;   // NaN where nothing is near
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * ny + y) * nx + x; }
  dvec3 at(int x, int y, int z) const { return origin + step * dvec3(x, y, z); }
};

struct Blocks {
  int nx = 0, ny = 0, nz = 0;
  std::vector<std::uint8_t> active;
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * ny + y) * nx + x; }
};

// Corner numbers have bit 0 for x, 1 for y, 2 for z. Tetrahedra walk from corner 0 to 7 along the axes in each order.
struct Tetrahedron {
  std::array<int, 4> corners;
  bool positive;
};
constexpr std::array<Tetrahedron, 6> tetrahedra = {{{{0, 1, 3, 7}, true},
                                                    {{0, 3, 2, 7}, true},
                                                    {{0, 2, 6, 7}, true},
                                                    {{0, 6, 4, 7}, true},
                                                    {{0, 4, 5, 7}, true},
                                                    {{0, 5, 1, 7}, true}}};

Lattice sample_lattice(const Field& field, double grid, Blocks& blocks) {
  Lattice lattice;
  lattice.step = grid;
  lattice.origin = dvec3(field.box.lower.x, 0, field.box.lower.z);
  const dvec3 size = field.box.upper - lattice.origin;
  const auto count = [&](double length) { return (static_cast<int>(length / (grid * large_block)) + 1) * large_block + 1; };
  lattice.nx = count(size.x), lattice.ny = count(size.y), lattice.nz = count(size.z);
  lattice.values.assign(static_cast<std::size_t>(lattice.nx) * lattice.ny * lattice.nz, std::nanf(""));
  blocks.nx = (lattice.nx - 1) / block, blocks.ny = (lattice.ny - 1) / block, blocks.nz = (lattice.nz - 1) / block;
  const std::size_t n = static_cast<std::size_t>(blocks.nx) * blocks.ny * blocks.nz;
  blocks.active.assign(n, 0);
  const auto corner = [&](std::size_t b) {
    const int x = static_cast<int>(b % blocks.nx), y = static_cast<int>(b / blocks.nx % blocks.ny),
              z = static_cast<int>(b / blocks.nx / blocks.ny);
    return std::array<int, 3>{x, y, z};
  };
  // From large blocks to small ones, wherever the surface may pass. The field is about metric; a little more than the
  // half diagonal finds most of the surface, and where it leaves what was found it is followed below.
  const auto may_pass = [&](const std::array<int, 3>& first, int side) {
    const double half = 0.5 * side, reach = 1.3 * std::sqrt(3.0) * half * grid;
    const dvec3 centre = lattice.origin + grid * (dvec3(first[0], first[1], first[2]) + half);
    const double d = field.distance(centre);
    // A field that has no shape near says so by `nothing_near`; shapes may still begin beyond what it looks at.
    return std::abs(d) < reach || (d == Field::nothing_near && std::sqrt(3.0) * half * grid > Field::looks_at);
  };
  const auto descend = [&](auto& self, const std::array<int, 3>& first, int side) -> void {
    if (!may_pass(first, side)) return;
    if (side == block) {
      blocks.active[blocks.index(first[0] / block, first[1] / block, first[2] / block)] = 1;
      return;
    }
    for (int k = 0; k < 8; ++k)
      self(self, {first[0] + (k & 1) * side / 2, first[1] + (k >> 1 & 1) * side / 2, first[2] + (k >> 2) * side / 2},
           side / 2);
  };
  const int lx = (lattice.nx - 1) / large_block, ly = (lattice.ny - 1) / large_block,
            lz = (lattice.nz - 1) / large_block;
  parallel_for(static_cast<std::size_t>(lx) * ly * lz, 1, [&](std::size_t b) {
    const int x = static_cast<int>(b % lx), y = static_cast<int>(b / lx % ly), z = static_cast<int>(b / lx / ly);
    descend(descend, {x * large_block, y * large_block, z * large_block}, large_block);
  });
  // Every point is sampled once, by the block it is the lower part of, also when only a lower neighbour is active.
  std::vector<std::uint8_t> sampled(n, 0);
  const auto sample_blocks = [&] {
    parallel_for(n, 64, [&](std::size_t b) {
      if (sampled[b]) return;
      const auto [bx, by, bz] = corner(b);
      bool needed = false;
      for (int k = 0; k < 8; ++k) {
        const int x = bx - (k & 1), y = by - (k >> 1 & 1), z = bz - (k >> 2);
        if (x >= 0 && y >= 0 && z >= 0 && blocks.active[blocks.index(x, y, z)]) needed = true;
      }
      if (!needed) return;
      sampled[b] = 1;
      for (int z = bz * block; z < (bz + 1) * block; ++z)
        for (int y = by * block; y < (by + 1) * block; ++y)
          for (int x = bx * block; x < (bx + 1) * block; ++x) {
            const float d = static_cast<float>(field.distance(lattice.at(x, y, z)));
            lattice.values[lattice.index(x, y, z)] = d == 0.0f ? 1e-7f : d;  // never a vertex on a lattice point
          }
    });
  };
  // Does the surface pass through the face of block b on side `axis`, `up`?
  const auto crosses = [&](const std::array<int, 3>& b, int axis, bool up) {
    bool inside = false, outside = false;
    for (int u = 0; u <= block; ++u)
      for (int v = 0; v <= block; ++v) {
        std::array<int, 3> p{b[0] * block, b[1] * block, b[2] * block};
        p[axis] += up ? block : 0, p[(axis + 1) % 3] += u, p[(axis + 2) % 3] += v;
        const float d = lattice.values[lattice.index(p[0], p[1], p[2])];
        inside |= d < 0, outside |= d > 0;
      }
    return inside && outside;
  };
  for (bool grew = true; grew;) {
    sample_blocks();
    std::vector<std::size_t> found;
    for (std::size_t b = 0; b < n; ++b) {
      if (!blocks.active[b]) continue;
      const std::array<int, 3> at = corner(b);
      for (int side = 0; side < 6; ++side) {
        std::array<int, 3> next = at;
        next[side / 2] += side % 2 ? 1 : -1;
        if (next[0] < 0 || next[1] < 0 || next[2] < 0 || next[0] >= blocks.nx || next[1] >= blocks.ny ||
            next[2] >= blocks.nz)
          continue;
        const std::size_t i = blocks.index(next[0], next[1], next[2]);
        if (!blocks.active[i] && crosses(at, side / 2, side % 2)) found.push_back(i);
      }
    }
    for (const std::size_t i : found) blocks.active[i] = 1;
    grew = !found.empty();
  }
  return lattice;
}

}  // namespace

HalfMesh polygonise(const Field& field, double grid) {
  Blocks blocks;
  const Lattice lattice = sample_lattice(field, grid, blocks);
  HalfMesh mesh;
  std::unordered_map<std::uint64_t, std::uint32_t> vertices;  // by lattice point and direction of the edge
  vertices.reserve(1 << 17);

  const auto cell = [&](int x, int y, int z) {
    std::array<float, 8> d;
    int inside = 0;
    for (int k = 0; k < 8; ++k) {
      d[k] = lattice.values[lattice.index(x + (k & 1), y + (k >> 1 & 1), z + (k >> 2))];
      if (std::isnan(d[k])) return;
      inside += d[k] < 0;
    }
    if (inside == 0 || inside == 8) return;
    const auto vertex = [&](int a, int b) {
      if (a > b) std::swap(a, b);  // corners of an edge are ordered: its direction is their difference
      const int ax = x + (a & 1), ay = y + (a >> 1 & 1), az = z + (a >> 2);
      const std::uint64_t key = lattice.index(ax, ay, az) * 8 + static_cast<std::uint64_t>(b - a);
      const auto [entry, fresh] = vertices.try_emplace(key, static_cast<std::uint32_t>(mesh.positions.size()));
      if (fresh) {
        const int by = y + (b >> 1 & 1);
        const double t = static_cast<double>(d[a]) / (static_cast<double>(d[a]) - d[b]);
        mesh.positions.push_back(glm::mix(lattice.at(ax, ay, az), lattice.at(x + (b & 1), by, z + (b >> 2)), t));
        mesh.on_midplane.push_back(ay == 0 && by == 0);
      }
      return entry->second;
    };
    const auto emit = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, bool flip) {
      mesh.triangles.push_back(flip ? uvec3(a, c, b) : uvec3(a, b, c));
    };
    for (const Tetrahedron& tet : tetrahedra) {
      std::array<int, 4> in{}, out{};
      int ni = 0, no = 0;
      for (int k = 0; k < 4; ++k) (d[tet.corners[k]] < 0 ? in[ni++] : out[no++]) = k;
      if (ni == 0 || no == 0) continue;
      // Sign of the permutation (in..., out...) of (0, 1, 2, 3) decides which way triangles turn.
      std::array<int, 4> order{};
      for (int k = 0; k < 4; ++k) order[k] = k < ni ? in[k] : out[k - ni];
      bool odd = false;
      for (int a = 0; a < 4; ++a)
        for (int b = a + 1; b < 4; ++b) odd ^= order[a] > order[b];
      const auto v = [&](int a, int b) { return vertex(tet.corners[order[a]], tet.corners[order[b]]); };
      const bool flip = odd == tet.positive;
      if (ni == 1) {
        emit(v(0, 1), v(0, 2), v(0, 3), flip);
      } else if (ni == 3) {
        emit(v(3, 0), v(3, 1), v(3, 2), flip);
      } else {
        const std::uint32_t a = v(0, 2), b = v(0, 3), c = v(1, 3), e = v(1, 2);
        emit(a, b, c, flip);
        emit(a, c, e, flip);
      }
    }
  };
  for (int bz = 0; bz < blocks.nz; ++bz)
    for (int by = 0; by < blocks.ny; ++by)
      for (int bx = 0; bx < blocks.nx; ++bx) {
        if (!blocks.active[blocks.index(bx, by, bz)]) continue;
        for (int z = 0; z < block; ++z)
          for (int y = 0; y < block; ++y)
            for (int x = 0; x < block; ++x) cell(bx * block + x, by * block + y, bz * block + z);
      }
  if (mesh.triangles.empty())
    throw InputError("the solids enclose nothing at this grid; give them larger radii or a finer grid_m");
  return mesh;
}

}  // namespace moomill
