#pragma once
// The surface of one animal: what does not change with the pose (Surface) and what does (PosedSurface).
#include <cstdint>
#include <string>
#include <vector>

#include "generator/core/math.h"

namespace moomill {

// How neutral-pose coordinates are normalised to [0, 1].
enum class NnopcsNormalization {
  box,       // per axis over the bounding box of the neutral surface (as in NePuMoo)
  diagonal,  // one scale, the diagonal of that box, centred at 0.5 (as in NOCS)
};

// Pose-independent. Vertices are split where normals or UVs are, so a position may occur several times.
struct Surface {
  std::vector<vec3> rest;                // metres, model space (Z up), as in the file's bind pose
  std::vector<vec3> normals;             // unit, bind pose
  std::vector<vec2> uvs;                 // empty, or one per vertex; (0, 0) is the top left texel corner (glTF)
  std::vector<vec3> colors;              // empty, or one linear colour per vertex that multiplies the base colour
  std::vector<uvec3> triangles;          // vertex indices, counter-clockwise seen from outside
  std::vector<std::uint16_t> materials;  // per triangle, index into the rig's materials
  std::vector<std::uint16_t> parts;      // per triangle, index into the rig's part names
  std::vector<vec3> nnopcs;              // per vertex in [0, 1]; empty until baked from the neutral pose
  Box neutral_box;                       // metres; what nnopcs is normalised by
  NnopcsNormalization normalization = NnopcsNormalization::box;
};

// One pose of a Surface. Same vertex and triangle indices.
struct PosedSurface {
  dvec3 origin{0};              // metres, world: positions are relative to it
  std::vector<vec3> positions;  // metres, world minus origin
  std::vector<vec3> normals;    // unit, world
};

// Fills nnopcs, neutral_box and normalization from positions of the neutral pose (model space, metres).
// Source of the two normalisations: NeTePu (WACV-W 2024) and Wang et al., NOCS (CVPR 2019).
void bake_nnopcs(Surface& surface, const std::vector<vec3>& neutral, NnopcsNormalization normalization);

// Metres in the neutral pose of a normalised coordinate: the inverse of what bake_nnopcs stores.
dvec3 nnopcs_to_metres(const Surface& surface, const dvec3& nnopcs);

}  // namespace moomill
