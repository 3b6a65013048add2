#pragma once
// The finish: what all coats of a species share. How hair lies and clumps, and how rough and bumpy every part is.
#include <string>
#include <vector>

#include "textures/hide.h"

namespace moomill {

// Bare parts and their shine.
struct PartFinish {
  std::string part;         // a trailing * matches the rest
  double roughness = 0.5;   // as in glTF: 0 a mirror, 1 matt
  double bump = 0;          // how much of the hair's unevenness it has
  double softness = 0.01;   // metres over which it fades into the hair
};

struct Finish {
  Hair hair;
  double roughness = 0.68;          // of hair
  double tuft_slope = 0.22;         // how steep tufts are: standard deviation of the slope, metres per metre
  double clump_slope = 0.10;        // alike, of the larger waves tufts lie in
  double clump_size = 0.035;        // metres
  std::vector<PartFinish> parts;
};

}  // namespace moomill
