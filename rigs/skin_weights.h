#pragma once
// Skin weights by diffusion inside a voxelised solid. One solver for what the builder makes and for bound scans.
//
// Every cell of the solid is seeded with joints, from the nearest bone (through the solid) or from what a caller knows,
// and the seeds are evened out by heat: with w the weight of a joint, p its seed and s a length in proportion to how
// thick the body is there,
//   -laplace(w) + (w - p) / s^2 = 0,   no flow through the skin.
// That is the bone heat of Baran and Popovic (2007) in the volume, where they solve it on the surface.
#include <vector>

#include "rigs/rig.h"
#include "rigs/voxel_solid.h"

namespace moomill {

// Part of a joint's skeleton: what is near it in the solid moves with the joint.
struct BoneSegment {
  int joint = 0;
  dvec3 from{0}, to{0};  // metres
  double radius = 0.1;   // metres, typical distance of the skin; nearness is measured in it, so that trunks are not carved up by legs
};

// The segments of a skinned skeleton: from every joint that moves skin to each of its children; where it has none, through
// the middle of its skin. `weights`: points x joints. The radius is the mean distance of the skin, weighted.
std::vector<BoneSegment> bone_segments(const std::vector<dvec3>& joints, const std::vector<int>& parents,
                                       const std::vector<dvec3>& points, const std::vector<double>& weights);

// Per cell and joint (cells x joints, cells first): what diffusion starts from. Rows sum to 1.
using Seeds = std::vector<float>;

// One joint per cell: that of the bone nearest through the solid, in units of the bone's radius (fast marching, Sethian
// 1996, as the geodesic voxel binding of Dionne and de Lasa, 2013, does by Dijkstra). Bones outside start at the cell nearest to them.
Seeds seeds_of_bones(const VoxelSolid& solid, const std::vector<BoneSegment>& bones, int joints);

// Chosen by `moomill rig deform` on the cow: from 0.5 to 2.5 of `reach`, the least area turned inside out.
struct DiffusionOptions {
  double reach = 1.2;   // smoothing length s per thickness of the body
  double slope = 0.6;   // thickness counts on in thinner parts beside it, less by this per distance
  double most = 0.43;   // of s, per thickness of the thickest part
};

// Weights at points on or in the solid (points x joints, points first; rows sum to 1). The same for any number of threads.
std::vector<double> diffuse_weights(const VoxelSolid& solid, const Seeds& seeds, int joints,
                                    const std::vector<dvec3>& points, const DiffusionOptions& options = {});

// At most four influences of a dense row, normalised, heaviest first: each weighs what it has above the fifth, so that weights stay
// continuous where joints take over from each other.
std::vector<Influence> strongest_influences(const double* weights, std::size_t joints);

}  // namespace moomill
