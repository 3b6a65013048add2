#pragma once
// The finish: what all coats of a species share. How hair lies and clumps, and how rough and bumpy every part is.
#include <string>
#include <vector>

#include "textures/hide.h"

namespace moomill {

// Bare parts and their shine.
struct PartFinish {
  std::string part;        // a trailing * matches the rest
  double roughness = 0.5;  // as in glTF: 0 a mirror, 1 matt
  double bump = 0;         // how much of the hair's unevenness it has
  double softness = 0.01;  // metres over which it fades into the hair
};

struct Finish {
  Hair hair;
  double roughness = 0.68;    // of hair
  double tuft_slope = 0.22;   // how steep tufts are across the hair: standard deviation, metres per metre
  double clump_slope = 0.10;  // alike, in any direction, of the larger waves tufts lie in
  double clump_size = 0.035;  // metres
  std::vector<PartFinish> parts;
};

// In the rig's UV space, as glTF has them.
struct FinishMaps {
  Image8 normal;     // tangent space, 3 channels, green towards -v; x along u of the neutral animal's triangles
  Image8 roughness;  // 1 channel
};

// Bakes the finish. What is finer than about two texels is not drawn but added to the roughness: normals that vary by a
// slope variance s^2 shine as broadly as one surface of alpha^2 + 2 s^2 (Olano and Baker, LEAN mapping, 2010). Parallel,
// deterministic. The normals are as the renderer reads them: per triangle, x along u made square to the shading normal.
FinishMaps bake_finish(const Finish& finish, Hide& hide, const TexelMap& texels);

}  // namespace moomill
