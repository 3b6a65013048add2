#pragma once
// Inverse kinematics of one leg: a ball joint at the top and a hinge below it bring the end of a chain to a point.
#include <functional>

#include "generator/core/math.h"

namespace moomill {

struct Range {
  double lower = -pi, upper = pi;  // radians
  double clamp(double v) const { return std::min(std::max(v, lower), upper); }
};

struct LegAngles {
  double pitch = 0, roll = 0;  // radians, of the ball joint: Ry(pitch) Rx(roll)
  double bend = 0;             // radians, of the hinge
  double miss = 0;             // metres between the chain's end and the target; 0 where it is within reach
};

// `chain(bend)`: the chain's end seen from the ball joint (metres) when that is unturned and the hinge is turned by
// `bend`; it need not be monotonic. Of several solutions the one nearest to `near` is taken, so that motion stays
// continuous. Out of reach (too far, too near, or beyond the ranges) it comes as near as the hinge lets it: no angle is
// ever beyond its range, and nothing is ever not-a-number.
LegAngles solve_leg(const std::function<dvec3(double)>& chain, const dvec3& target, const Range& pitch, const Range& roll,
                    const Range& bend, double near);

inline dquat about_x(double radians) { return {std::cos(0.5 * radians), std::sin(0.5 * radians), 0, 0}; }
inline dquat about_y(double radians) { return {std::cos(0.5 * radians), 0, std::sin(0.5 * radians), 0}; }
inline dquat about_z(double radians) { return {std::cos(0.5 * radians), 0, 0, std::sin(0.5 * radians)}; }

}  // namespace moomill
