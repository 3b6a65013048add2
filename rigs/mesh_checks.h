#pragma once
// What is sound about a triangle mesh and about its UV atlas, in numbers. Used by the linter, the builder's tests and
// the deformation studies (pose first, then check the posed positions with the weld of the neutral ones).
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "generator/core/surface.h"
#include "generator/core/topology.h"

namespace moomill {

struct MeshChecks {
  std::size_t vertices = 0, triangles = 0, edges = 0;  // vertices after welding, used ones only
  std::size_t border_edges = 0;        // with one triangle
  std::size_t non_manifold_edges = 0;  // with more than two
  std::size_t inconsistent_edges = 0;  // whose two triangles face opposite ways
  std::size_t non_manifold_vertices = 0;  // whose triangles form more than one fan
  std::size_t components = 0, border_loops = 0;
  double genus = 0;  // handles, summed over components; meaningful when nothing above is non-manifold
  std::size_t degenerate = 0;  // triangles with two equal corners, or less than 1e-9 of their longest side squared in area
  // Smallest angle of a triangle, degrees: percentiles 0, 1, 5, 50 over the triangles, and how many have less than 1,
  // 5, 10, 20, 30 degrees.
  std::array<double, 4> least_angle_deg{};
  std::array<std::size_t, 5> slivers{};
  double sharpest_fold_deg = 0;  // largest turn of the normal across an edge: 180 lies back on itself
  std::size_t self_intersections = 0;  // pairs of triangles that meet elsewhere than at what they share
  std::vector<std::pair<std::uint32_t, std::uint32_t>> intersecting;  // the first 100 of them, ascending
  double volume = 0, area = 0;  // cubic and square metres; volume is signed, meaningful when closed
  double shortest_edge = 0, longest_edge = 0;  // metres
  // Closed, two-manifold, facing one way, of one piece.
  bool watertight() const {
    return border_edges + non_manifold_edges + inconsistent_edges + non_manifold_vertices == 0 && components == 1;
  }
};

// `place` as from weld(), of these or of the neutral positions. Self-intersections are decided with exact signs of
// determinants (filtered doubles, then 113 bits, which hold any of floats of an animal's size); touching counts.
MeshChecks check_mesh(const std::vector<vec3>& positions, const std::vector<uvec3>& triangles,
                      const std::vector<std::uint32_t>& place, bool intersections = true);
inline MeshChecks check_mesh(const Surface& s, bool intersections = true) {
  return check_mesh(s.rest, s.triangles, weld(s.rest), intersections);
}

// A ring on the surface that bounds no piece of it: there is a handle.
struct Ring {
  dvec3 centre{0};    // metres
  double length = 0;  // metres around
};

// The rings of a closed, two-manifold mesh, two for each handle (one around it, one through its hole), shortest
// first: those that the shortest paths from one vertex leave over (Erickson and Whittlesey 2005), each replaced by the
// shortest through its first vertex. For a message that says where.
std::vector<Ring> find_rings(const std::vector<vec3>& positions, const std::vector<uvec3>& triangles,
                             const std::vector<std::uint32_t>& place);

struct AtlasChecks {
  std::size_t outside = 0;   // vertices off the unit square
  std::size_t flat = 0;      // triangles without area in the atlas
  std::size_t mirrored = 0;  // triangles seen from behind
  std::size_t charts = 0;
  std::size_t texels = 0;   // of the raster below
  std::size_t covered = 0;  // texels whose centre some triangle covers
  std::size_t twice = 0;    // texels whose centre is covered more than once; repeated use counts as overlap
  dvec2 first_twice{0};     // UV of the first such texel
  double occupancy() const { return texels ? static_cast<double>(covered) / static_cast<double>(texels) : 0; }
  double overlap() const { return texels ? static_cast<double>(twice) / static_cast<double>(texels) : 0; }
  // Atlas sides per metre of surface (square root of the ratio of areas): percentiles 5, 50, 95 by surface area.
  std::array<double, 3> density{};
  double density_spread() const { return density[0] > 0 ? density[2] / density[0] : 0; }
  // How many times longer a small square becomes along one direction than along the other: percentiles 50, 95, 99.
  std::array<double, 3> stretch{};
  double gutter_texels = 0;  // least distance between covered texels of two charts, at `resolution`; capped at 64
};

// Rasterises at `resolution` (a power of two) with coordinates of 24 bits and a top-left rule: triangles that share
// an edge never cover a texel twice. A surface without UVs gives zeros.
AtlasChecks check_atlas(const Surface& surface, int resolution = 2048);

}  // namespace moomill
