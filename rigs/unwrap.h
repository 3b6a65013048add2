#pragma once
// UV atlas by planar charts: regions of triangles that face about one direction, flattened along it, packed without
// overlap. Internal to the quadruped builder.
#include <cstdint>
#include <vector>

#include "generator/core/math.h"

namespace moomill {

struct Chart {
  std::vector<std::uint32_t> triangles;  // of the mesh that was cut
  std::vector<std::uint32_t> vertices;   // of the mesh that was cut, ascending
  std::vector<dvec2> flat;               // per entry of `vertices`: metres after cutting, [0, 1] after packing
};

// Cuts a manifold (with or without border) into charts, none of which overlaps itself when flattened. Charts grow
// around proxy normals as in variational shape approximation (Cohen-Steiner, Alliez, Desbrun 2004).
std::vector<Chart> cut_charts(const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles);

// Packs the charts into the unit square, all at one scale, each with `gutter` (share of the side) of free border:
// their bounding rectangles on a skyline. Charts are turned to lie flat; none is mirrored.
void pack_charts(std::vector<Chart>& charts, double gutter);

}  // namespace moomill
