#pragma once
// What `moomill rig info` and `moomill rig check` say.
#include <string>
#include <vector>

#include "rigs/species.h"

namespace moomill {

std::string describe_rig(const Rig& rig);  // joints as a tree, clips, bounds in metres, weights, materials; for people

struct Finding {
  enum class Level { wrong, suspicious } level;
  std::string text;  // one sentence: what, where, how many
};
std::vector<Finding> check_rig(const Rig& rig);          // weights, degenerate triangles, isolated vertices, open borders, scale, bind pose, ...
std::vector<Finding> check_species(const Species& species);  // also: keypoints in the body, symmetry, limits, expected size

}  // namespace moomill
