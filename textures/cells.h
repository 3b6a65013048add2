#pragma once
// Polygonal patches in a network of lines: the coat of giraffes, the dapples of grey horses, tortoiseshell. Patches are
// the Voronoi cells of points strewn over the hide, with smaller cells where parts ask for them.
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "textures/hide.h"

namespace moomill {

// Lengths in metres on the neutral animal.
struct CellPattern {
  vec3 line{0.62f, 0.50f, 0.34f}, cell{0.22f, 0.09f, 0.03f};  // linear Rec. 709
  vec3 center{0.18f, 0.07f, 0.024f};  // of the cell, far from its border
  double size = 0.24;                 // across a cell
  double gap = 0.022;                 // width of the lines; scales with the cell
  double regularity = 0.8;            // least distance of neighbouring points, in sizes; at most 0.9
  double jag = 0;                     // how far lobes of the border reach in: 0 straight polygons, more vine leaves
  double raggedness = 0.004, softness = 0.006;
  double variation = 0.15;            // relative brightness from cell to cell
  std::vector<std::pair<std::string, double>> parts;  // factor on the size in a part (a trailing * matches the rest)
};

// The points of one animal and a grid to find them.
struct CellField {
  struct Point {
    dvec3 at;
    double radius;  // metres, half its size
    std::uint32_t hash;
  };
  std::vector<Point> points;
  dvec3 origin{0};
  double cell = 1;  // metres, of the grid
  int nx = 0, ny = 0, nz = 0;
  std::vector<std::uint32_t> begin, sorted;  // per grid cell, into `sorted`: points that may own something there
};

// Throws InputError where no point of the hide would be painted (an empty surface).
CellField strew_cells(const CellPattern& pattern, const Hide& hide, std::uint64_t seed);

struct CellSample {
  double depth = 0;    // metres inside the cell's border, the line's middle being 0
  double inward = 0;   // share of the way from the border to the cell's point
  double scale = 1;    // size of this cell over the pattern's
  std::uint32_t hash = 0;
};
// The cell that owns a point; plain Voronoi borders where sizes agree, spheres of Apollonius where they differ.
CellSample sample_cells(const CellPattern& pattern, const CellField& field, const dvec3& at);

vec3 cell_color(const CellPattern& pattern, const CellField& field, const HidePoint& point, std::uint32_t noise_key);

}  // namespace moomill
