#pragma once
// Clips of a quadruped from waves, keys and gaits, with feet planted by inverse kinematics. Internal to the quadruped
// builder.
#include <vector>

#include "rigs/quadruped.h"

namespace moomill {

// One clip per ClipSpec, sampled into linear quaternion and translation channels. Throws InputError on unknown joints.
std::vector<Clip> build_clips(const QuadrupedSpec& spec, const Rig& rig);

}  // namespace moomill
