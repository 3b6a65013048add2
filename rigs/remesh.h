#pragma once
// From the implicit body to triangles: polygonisation of the half y >= 0, then remeshing to even edges. Internal to
// the quadruped builder.
#include <cstdint>
#include <vector>

#include "generator/core/math.h"
#include "rigs/solids.h"

namespace moomill {

// The left half of a symmetric body: a manifold whose border lies on y = 0.
struct HalfMesh {
  std::vector<dvec3> positions;
  std::vector<uvec3> triangles;           // counter-clockwise seen from outside
  std::vector<std::uint8_t> on_midplane;  // per vertex: lies on y = 0, which is the border
};

// Marching tetrahedra on the Kuhn subdivision of a cubic lattice: six tetrahedra per cube share its main diagonal, so
// neighbours agree on every face and the result is a manifold without case tables (Doi and Koide 1991; Kuhn 1960).
HalfMesh polygonise(const Field& field, double grid);

// Isotropic remeshing on the surface of the field: split, collapse, flip, relax (Botsch and Kobbelt 2004), with edge
// length target_edge * FieldSample::detail. Vertices on y = 0 stay there, and no inner edge joins two of them, so that
// the mirrored whole is a manifold too.
void remesh(HalfMesh& mesh, const Field& field, double target_edge, int rounds);

}  // namespace moomill
