#pragma once
// Makes a rig of a static mesh and clicked keypoints: the skeleton of a species fitted to them, weights by diffusion in
// the voxelised mesh.
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rigs/species.h"

namespace moomill {

struct BindSpec {
  std::string source;  // file, for messages
  std::vector<dvec3> keypoints;                      // one per keypoint of the species, in its order, as the scan is loaded
  std::vector<std::pair<std::string, dvec3>> joints;  // further joints that were clicked, alike
  std::optional<double> yaw_deg;  // turns the scan to face +X; by default the keypoints tell
  std::optional<double> height;   // metres, of the scan without its ground; by default the keypoints tell
};

struct BoundScan {
  Species species;                 // rig with its own materials, keypoints, edges, pairs, limits; no clips
  std::vector<std::string> notes;  // what was left out or carried along, one sentence each
  double cell = 0;                 // metres
};

// The scan is turned to face +X, scaled, and stood on z = 0; joints that are keypoints come to lie on them, the others
// follow by a thin-plate spline through all (Bookstein 1989, in three dimensions). The species' own weights, carried over by the inverse
// spline, seed the cells of the voxelised scan. A flat piece at the feet is left out; small loose pieces move rigidly with
// the body next to them. Throws InputError on a scan without triangles or volume, on two animals, on keypoints outside
// the mesh or with left and right swapped.
BoundScan bind_scan(Rig scan, const Species& base, const BindSpec& spec);

}  // namespace moomill
