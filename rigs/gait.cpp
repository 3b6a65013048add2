#include "rigs/gait.h"

#include <cmath>

namespace moomill {

double smooth(double u) {
  u = std::clamp(u, 0.0, 1.0);
  return u * u * (3 - 2 * u);
}

FootState gait_foot(const GaitSpec& g, const GaitLegs& legs, double phase, double cycle, double leg_length,
                    double side) {
  double s = cycle - phase;
  s -= std::floor(s);
  const double travel = g.stride * g.duty * leg_length;
  const double toe = legs.toe_deg * degrees, heel = legs.heel_deg * degrees;
  FootState f;
  double x = 0;
  if (s < g.duty) {
    const double u = s / g.duty;
    x = travel * (0.5 - u);
    f.roll = -heel * (1 - smooth(u / 0.08)) + 0.8 * toe * smooth((u - 0.84) / 0.16);
    f.load = legs.load_deg * degrees * std::sin(pi * smooth(u));
  } else {
    // Cubic Hermite from lift-off to touch-down with the ground's velocity at both ends: the foot neither kicks nor
    // skids.
    const double w = (s - g.duty) / (1 - g.duty), w2 = w * w, w3 = w2 * w;
    const double slope = -travel / g.duty * (1 - g.duty);
    x = travel * (-0.5 * (2 * w3 - 3 * w2 + 1) + 0.5 * (3 * w2 - 2 * w3)) + slope * ((w3 - 2 * w2 + w) + (w3 - w2));
    f.offset.z = legs.lift * leg_length * 16 * w2 * (1 - w) * (1 - w);
    const double early = std::sin(pi * std::pow(w, 0.75));
    f.fold = legs.fold_deg * degrees * early * early;
    f.pastern = legs.pastern_deg * degrees * early * early;
    f.roll = 0.8 * toe * (1 - smooth(w / 0.5)) - heel * smooth((w - 0.6) / 0.4);
    f.ground = 1 - smooth(w / 0.25) + smooth((w - 0.7) / 0.3);
  }
  f.offset.x = x + legs.at.x * leg_length;
  f.offset.y = side * legs.at.y * leg_length;
  return f;
}

FootState stepping_foot(const std::vector<StepSpec>& steps, double time, double leg_length, double side) {
  FootState f;
  dvec2 at(0);
  for (const StepSpec& s : steps) {
    if (time >= s.end) {
      at = s.to;
    } else if (time > s.begin) {
      const double w = (time - s.begin) / (s.end - s.begin), up = std::sin(pi * w);
      at = glm::mix(at, s.to, smooth(w));
      f.offset.z = s.lift * leg_length * up * up;
      f.fold = 25 * degrees * up * up;
      f.pastern = 20 * degrees * up * up;
      f.ground = 1 - up * up;
    }
  }
  f.offset.x = at.x * leg_length;
  f.offset.y = side * at.y * leg_length;
  return f;
}

}  // namespace moomill
