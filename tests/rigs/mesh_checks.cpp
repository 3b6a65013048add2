// The mesh and atlas checks, on bodies whose numbers are known.
#include "rigs/mesh_checks.h"

#include <doctest/doctest.h>

#include <cmath>

using namespace moomill;

namespace {

struct Soup {
  std::vector<vec3> positions;
  std::vector<uvec3> triangles;
  MeshChecks check() const { return check_mesh(positions, triangles, weld(positions)); }
  void add(const Soup& other) {
    const auto first = static_cast<std::uint32_t>(positions.size());
    positions.insert(positions.end(), other.positions.begin(), other.positions.end());
    for (const uvec3& t : other.triangles) triangles.push_back(t + first);
  }
};

Soup cube(const vec3& at, float side) {
  Soup s;
  for (int k = 0; k < 8; ++k) s.positions.push_back(at + side * vec3(k & 1, k >> 1 & 1, k >> 2));
  s.triangles = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                 {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return s;
}

Soup torus(double big, double small, int n, int m) {
  Soup s;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) {
      const double u = 2 * pi * i / n, v = 2 * pi * j / m, r = big + small * std::cos(v);
      s.positions.emplace_back(r * std::cos(u), r * std::sin(u), small * std::sin(v));
      const auto at = [&](int a, int b) { return static_cast<std::uint32_t>((i + a) % n * m + (j + b) % m); };
      s.triangles.emplace_back(at(0, 0), at(1, 0), at(1, 1));
      s.triangles.emplace_back(at(0, 0), at(1, 1), at(0, 1));
    }
  return s;
}

Surface sheet(int n) {  // the unit square of n x n quads, UV = position, seen from +z
  Surface s;
  for (int y = 0; y <= n; ++y)
    for (int x = 0; x <= n; ++x) {
      s.rest.emplace_back(float(x) / n, float(y) / n, 0);
      s.uvs.emplace_back(float(x) / n, 1 - float(y) / n);
    }
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const auto at = [&](int a, int b) { return static_cast<std::uint32_t>((y + b) * (n + 1) + x + a); };
      s.triangles.emplace_back(at(0, 0), at(1, 0), at(1, 1));
      s.triangles.emplace_back(at(0, 0), at(1, 1), at(0, 1));
    }
  return s;
}

}  // namespace

TEST_CASE("Mesh checks: a cube, a torus and two bodies") {
  const MeshChecks c = cube(vec3(1), 2).check();
  CHECK(c.watertight());
  CHECK(c.vertices == 8);
  CHECK(c.edges == 18);
  CHECK(c.genus == 0);
  CHECK(c.volume == doctest::Approx(8));
  CHECK(c.area == doctest::Approx(24));
  CHECK(c.least_angle_deg[0] == doctest::Approx(45));
  CHECK(c.sharpest_fold_deg == doctest::Approx(90));
  CHECK(c.self_intersections == 0);
  CHECK(c.degenerate == 0);

  const MeshChecks t = torus(1, 0.25, 200, 100).check();
  CHECK(t.watertight());
  CHECK(t.genus == 1);
  CHECK(t.volume == doctest::Approx(2 * pi * pi * 0.0625).epsilon(2e-3));
  CHECK(t.area == doctest::Approx(4 * pi * pi * 0.25).epsilon(2e-3));
  CHECK(t.self_intersections == 0);
  const Soup ring = torus(1, 0.25, 64, 32);
  const std::vector<Ring> rings = find_rings(ring.positions, ring.triangles, weld(ring.positions));
  REQUIRE(rings.size() == 2);
  CHECK(rings[0].length == doctest::Approx(2 * pi * 0.25).epsilon(0.05));
  CHECK(glm::length(rings[0].centre) == doctest::Approx(1).epsilon(0.05));
  const Soup box = cube(vec3(1), 2);
  CHECK(find_rings(box.positions, box.triangles, weld(box.positions)).empty());

  Soup two = cube(vec3(0), 1);
  two.add(cube(vec3(3), 1));
  CHECK(two.check().components == 2);
  CHECK(!two.check().watertight());
  CHECK(two.check().genus == 0);
}

TEST_CASE("Mesh checks: what is wrong is counted") {
  Soup open = cube(vec3(0), 1);
  open.triangles.pop_back();
  MeshChecks c = open.check();
  CHECK(c.border_edges == 3);
  CHECK(c.border_loops == 1);
  CHECK(c.genus == 0);
  CHECK(!c.watertight());

  Soup turned = cube(vec3(0), 1);
  std::swap(turned.triangles[0].x, turned.triangles[0].y);
  CHECK(turned.check().inconsistent_edges == 3);

  Soup touching = cube(vec3(0), 1);  // two cubes that share one corner
  touching.add(cube(vec3(1), 1));
  CHECK(touching.check().non_manifold_vertices == 1);
  CHECK(touching.check().components == 1);
  CHECK(touching.check().self_intersections == 0);

  Soup edge = cube(vec3(0), 1);  // two cubes that share one edge
  edge.add(cube(vec3(1, 1, 0), 1));
  CHECK(edge.check().non_manifold_edges == 1);

  Soup flat;
  flat.positions = {{0, 0, 0}, {1, 0, 0}, {0.5f, 1e-12f, 0}, {0.5f, 1, 0}};
  flat.triangles = {{0, 1, 2}, {0, 2, 3}, {0, 0, 3}};
  c = flat.check();
  CHECK(c.degenerate == 2);
  CHECK(c.slivers[0] == 2);
}

TEST_CASE("Mesh checks: self-intersections are found, neighbours are not taken for them") {
  Soup s = cube(vec3(0), 1);
  s.add(cube(vec3(0.5f), 1));
  // Every face of one cube cuts three of the other's; counted against all pairs in the plainest way there is.
  const MeshChecks c = s.check();
  CHECK(c.self_intersections > 0);
  for (const auto& [a, b] : c.intersecting) CHECK((a < 12 && b >= 12));
  // Two squares that cross like an X: each triangle of one meets some of the other.
  Soup cross;
  cross.positions = {{-1, 0, -1}, {1, 0, -1}, {1, 0, 1}, {-1, 0, 1}, {0, -1, -1}, {0, 1, -1}, {0, 1, 1}, {0, -1, 1}};
  cross.triangles = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}};
  CHECK(cross.check().self_intersections == 4);
  // A corner that pokes through a triangle it shares a vertex with.
  Soup poke;
  poke.positions = {{0, 0, 0}, {2, 0, 0}, {0, 2, 0}, {1, 0.3f, 1}, {0.8f, 0.5f, -1}};
  poke.triangles = {{0, 1, 2}, {0, 3, 4}};
  CHECK(poke.check().self_intersections == 1);
  // Folded flat onto its neighbour; unfolded it is none.
  Soup fold;
  fold.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}, {0.25f, 0.5f, 0}};
  fold.triangles = {{0, 1, 2}, {1, 0, 4}};
  CHECK(fold.check().self_intersections == 1);
  fold.triangles = {{0, 1, 2}, {1, 3, 2}};
  CHECK(fold.check().self_intersections == 0);
  // Coplanar, one within the other, without touching edges.
  Soup inside;
  inside.positions = {{0, 0, 0}, {3, 0, 0}, {0, 3, 0}, {0.5f, 0.5f, 0}, {1, 0.5f, 0}, {0.5f, 1, 0}};
  inside.triangles = {{0, 1, 2}, {3, 4, 5}};
  CHECK(inside.check().self_intersections == 1);
  for (int k = 3; k < 6; ++k) inside.positions[k].z = 1e-6f;
  CHECK(inside.check().self_intersections == 0);
}

TEST_CASE("Atlas checks: a sheet that fills half the square, twice used, stretched") {
  Surface s = sheet(16);
  for (vec2& uv : s.uvs) uv.x *= 0.5f;
  AtlasChecks c = check_atlas(s, 512);
  CHECK(c.occupancy() == 0.5);
  CHECK(c.twice == 0);
  CHECK(c.charts == 1);
  CHECK(c.mirrored == 0);
  CHECK(c.outside == 0);
  for (const double d : c.density) CHECK(d == doctest::Approx(std::sqrt(0.5)));
  for (const double d : c.stretch) CHECK(d == doctest::Approx(2));
  CHECK(c.gutter_texels == 64);

  // The same sheet again, 16 texels to the right, mirrored.
  Surface both = s;
  for (std::size_t i = 0; i < s.rest.size(); ++i) {
    both.rest.push_back(s.rest[i] + vec3(0, 0, 1));
    both.uvs.emplace_back(0.5f - s.uvs[i].x + 0.5f + 16.0f / 512, s.uvs[i].y);
  }
  for (const uvec3& t : s.triangles) both.triangles.push_back(t + static_cast<std::uint32_t>(s.rest.size()));
  c = check_atlas(both, 512);
  CHECK(c.charts == 2);
  CHECK(c.mirrored == s.triangles.size());
  CHECK(c.outside > 0);
  CHECK(c.twice == 0);
  CHECK(c.gutter_texels == doctest::Approx(17));
  // On top of each other by 8 texels.
  for (std::size_t i = s.rest.size(); i < both.uvs.size(); ++i) both.uvs[i].x -= 24.0f / 512;
  c = check_atlas(both, 512);
  CHECK(c.twice == 8 * 512);
}
