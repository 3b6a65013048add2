#pragma once
// A surface as a grid of cells: those it passes through and those it encloses. Cells are neighbours only where the solid
// goes on from one to the other, so what travels from cell to cell stays out of the air: it does not get from leg to leg
// or from an ear to the neck.
#include <array>
#include <cstdint>
#include <vector>

#include "generator/core/math.h"

namespace moomill {

struct VoxelSolid {
  dvec3 lower{0};    // metres, corner of the grid
  double cell = 0;   // metres, edge of a cell
  std::array<int, 3> size{};                   // cells along x, y, z
  std::vector<std::int32_t> index;             // per place of the grid: the cell there, -1 outside the solid
  std::vector<std::uint32_t> places;           // per cell: its place, (z * ny + y) * nx + x
  std::vector<std::array<std::int32_t, 6>> near;  // per cell: -x, +x, -y, +y, -z, +z, -1 where the solid ends
  std::vector<std::uint8_t> on_surface;        // per cell: the surface passes through it
  std::vector<float> thickness;                // per cell: radius of the largest ball inside the solid that holds it, metres
  double closed_gap = 0;                       // metres: gaps up to about this width were closed to find an inside

  dvec3 centre(std::size_t cell_index) const;
  // The cell a point lies in, or the nearest one within `reach` (metres); -1 when there is none.
  int find(const dvec3& p, double reach) const;
  std::size_t enclosed() const;  // cells that the surface does not pass through
};

// Any triangles will do: open borders are capped, gaps that remain are closed as far as needed, orientation, doubled and
// non-manifold faces do not matter. Metres. Where the surface encloses nothing, no cell is enclosed.
VoxelSolid voxelise(const std::vector<dvec3>& positions, const std::vector<uvec3>& triangles, double cell);

}  // namespace moomill
