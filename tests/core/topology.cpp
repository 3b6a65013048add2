#include "generator/core/topology.h"

#include <doctest/doctest.h>

using namespace moomill;

TEST_CASE("vertices at one place are one, minus zero is zero, and numbers come in order") {
  const std::vector<vec3> p = {{1, 0, 0}, {0, 0.0f, 0}, {0, -0.0f, 0}, {1, 0, 0}, {1, 0, 1e-30f}};
  CHECK(weld(p) == std::vector<std::uint32_t>{0, 1, 1, 0, 2});
  CHECK(weld(std::vector<dvec3>{{0, 0, -0.0}, {0, 0, 1e-300}, {0, 0, 0}}) == std::vector<std::uint32_t>{0, 1, 0});
}

TEST_CASE("triangles that share a vertex hang together, also through a weld") {
  const std::vector<uvec3> triangles = {{0, 1, 2}, {2, 3, 4}, {5, 6, 7}};
  DisjointSets apart = connected_vertices(9, triangles);
  CHECK(apart.find(4) == 0);
  CHECK(apart.find(7) == 5);
  CHECK(apart.find(8) == 8);
  DisjointSets welded = connected_vertices(9, triangles, {0, 1, 2, 3, 4, 4, 6, 7, 8});
  CHECK(welded.find(7) == 0);
  const auto near = vertex_neighbours(9, triangles);
  CHECK(near[2] == std::vector<std::uint32_t>{0, 1, 3, 4});
  CHECK(near[8].empty());
}
