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

// Per cell and joint (cells x joints, cells first): what diffusion starts from. Rows sum to 1.
using Seeds = std::vector<float>;

// One joint per cell: that of the bone nearest through the solid, in units of the bone's radius (fast marching, Sethian
// 1996, as the geodesic voxel binding of Dionne and de Lasa, 2013, does by Dijkstra). Bones outside start at the cell nearest to them.
Seeds seeds_of_bones(const VoxelSolid& solid, const std::vector<BoneSegment>& bones, int joints);

struct DiffusionOptions {
  double reach = 0.5;      // smoothing length s per thickness of the body
  double most = 0.1;       // metres, of s
};

// Weights at points on or in the solid (points x joints, points first; rows sum to 1). The same for any number of threads.
std::vector<double> diffuse_weights(const VoxelSolid& solid, const Seeds& seeds, int joints,
                                    const std::vector<dvec3>& points, const DiffusionOptions& options = {});

// The four largest of a dense row, normalised; weights of 0.01 and less are dropped. A joint and its twin that would be the fourth and
// the fifth and weigh the same go together when `keep_twins` holds (on the midplane of a symmetric animal).
std::vector<Influence> strongest_influences(const double* weights, const std::vector<int>& twin, bool keep_twins);

}  // namespace moomill
