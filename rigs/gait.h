#pragma once
// Where a foot is at one moment of a gait or between steps. Internal to the clip builder.
#include <vector>

#include "rigs/motion.h"

namespace moomill {

// What a foot is asked for. Lengths in metres, angles in radians.
struct FootState {
  dvec3 offset{0};    // of the sole from where it stands: forward, to the left, up
  double roll = 0;    // of the hoof: over its toe where positive, over its heel where negative
  double ground = 1;  // how far the ground rules the attitude of hoof and pastern: 1 in stance, 0 in mid-swing
  double load = 0;    // how far the fetlock sinks
  double fold = 0, pastern = 0;  // flexion in the swing
};

double smooth(double u);  // 0 below 0, 1 above 1, without a kink

// At `cycle` (in cycles) of a gait in place. `leg_length`, metres; `side`: 1 for a leg of the left, -1 of the right.
FootState gait_foot(const GaitSpec& gait, const GaitLegs& legs, double phase, double cycle, double leg_length,
                    double side);

// At `time` (share of the duration) of a foot that steps now and then. `steps`: those of this foot, in order of time.
FootState stepping_foot(const std::vector<StepSpec>& steps, double time, double leg_length, double side);

}  // namespace moomill
