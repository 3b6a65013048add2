#pragma once
// UV atlas: a surface is cut into few charts that flatten with little stretch, and these are packed without overlap.
// Internal to the quadruped builder.
#include <cstdint>
#include <vector>

#include "generator/core/math.h"

namespace moomill {

struct Chart {
  std::vector<std::uint32_t> triangles;  // of the mesh that was cut, ascending
  std::vector<std::uint32_t> vertices;   // of the mesh that was cut, ascending
  std::vector<dvec2> flat;               // per entry of `vertices`: metres after cutting, [0, 1] after packing
};

// Cuts a manifold (with or without border) into charts, none of which overlaps itself when flattened. Small charts
// grow around proxy normals as in variational shape approximation (Cohen-Steiner, Alliez, Desbrun 2004); neighbours
// are then merged as long as the union flattens with little stretch. Seams that can be seen (that face outwards or
// upwards, for a left half of an animal: +y, +z) go first, so those that stay lie under the belly and inside the legs.
std::vector<Chart> cut_charts(const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles);

// Flattens the chart as rigidly as can be, from the flat positions it has: local and global steps in turn (Liu, Zhang,
// Xu, Gotsman and Gortler 2008, "as rigid as possible"). Keeps the chart's area.
void flatten_rigidly(Chart& chart, const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles,
                     int rounds);

// How a chart's flat map treats lengths.
struct Stretch {
  bool turned_over = false;  // some triangle is, or has no area
  double worst = 1;          // largest singular value, or one over the smallest: 1 is none
  double uneven = 0;         // share of the area where the square root of the area's ratio is off by more than 12 %
};
Stretch measure_stretch(const Chart& chart, const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles);

// True when the chart's border crosses or touches itself in the plane: with no triangle turned over, the chart then
// covers some place twice.
bool border_crosses(const Chart& chart, const std::vector<uvec3>& triangles);

// Packs the charts into the unit square, all at one scale, at least `gutter` (share of the side) apart and half of
// that from the square's border: their outlines on a raster, large charts first, each in the turn by which it ends
// lowest. None is mirrored.
void pack_charts(std::vector<Chart>& charts, const std::vector<uvec3>& triangles, double gutter);

}  // namespace moomill
