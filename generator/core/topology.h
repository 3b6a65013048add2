#pragma once
// What hangs together in a triangle mesh.
#include <cstdint>
#include <vector>

#include "generator/core/math.h"

namespace moomill {

// For every vertex the number of its place: vertices with bit-equal positions share it (minus zero is zero), so that seams
// of UVs and normals are not borders. Numbers are dense, in order of first occurrence.
std::vector<std::uint32_t> weld(const std::vector<vec3>& positions);
std::vector<std::uint32_t> weld(const std::vector<dvec3>& positions);

// Sets that grow together (union-find with path halving). A set is named by the least of its members.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n);
  std::uint32_t find(std::uint32_t v);
  void join(std::uint32_t a, std::uint32_t b);

 private:
  std::vector<std::uint32_t> root_;
};

// Sets of vertices joined by triangles. `place` (per vertex of the triangles, may be empty: each its own) comes from weld().
DisjointSets connected_vertices(std::size_t count, const std::vector<uvec3>& triangles,
                                const std::vector<std::uint32_t>& place = {});

// Per vertex those it shares an edge with, ascending.
std::vector<std::vector<std::uint32_t>> vertex_neighbours(std::size_t count, const std::vector<uvec3>& triangles,
                                                          const std::vector<std::uint32_t>& place = {});

}  // namespace moomill
