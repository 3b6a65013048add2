#include "rigs/leg_ik.h"

namespace moomill {
namespace {

// The hinge that makes the chain as long as the target is far.
double solve_hinge(const std::function<dvec3(double)>& chain, double length, const Range& range, double near) {
  constexpr int samples = 96;
  const auto excess = [&](double bend) { return glm::length(chain(bend)) - length; };
  const auto at = [&](int i) { return range.lower + (range.upper - range.lower) * i / samples; };
  double best = range.clamp(near), best_off = std::abs(excess(best)), root = 0;
  bool found = false;
  double before = excess(at(0));
  for (int i = 1; i <= samples; ++i) {
    const double here = excess(at(i));
    if (std::abs(here) < best_off) best = at(i), best_off = std::abs(here);
    if (before * here <= 0) {
      double low = at(i - 1), high = at(i);
      const bool rising = before <= here;
      for (int k = 0; k < 50; ++k) {
        const double middle = 0.5 * (low + high);
        ((excess(middle) < 0) == rising ? low : high) = middle;
      }
      const double candidate = 0.5 * (low + high);
      if (!found || std::abs(candidate - near) < std::abs(root - near)) root = candidate, found = true;
    }
    before = here;
  }
  if (found) return root;
  if (std::abs(excess(range.lower)) <= best_off) best = range.lower;
  return best;
}

double wrapped(double angle) {
  return std::remainder(angle, 2 * pi);
}

}  // namespace

LegAngles solve_leg(const std::function<dvec3(double)>& chain, const dvec3& target, const Range& pitch, const Range& roll,
                    const Range& bend, double near) {
  LegAngles a;
  if (!all_finite(target)) return a.bend = bend.clamp(near), a.miss = std::numeric_limits<double>::infinity(), a;
  a.bend = solve_hinge(chain, glm::length(target), bend, near);
  const dvec3 end = chain(a.bend);
  // Sideways first: r cos(angle of the end in the yz plane + roll) = y of the target, on the side the leg hangs.
  const double r = std::hypot(end.y, end.z);
  if (r > 0) {
    const double now = std::atan2(end.z, end.y), wanted = std::acos(std::clamp(target.y / r, -1.0, 1.0));
    a.roll = roll.clamp(wrapped((now < 0 ? -wanted : wanted) - now));
  }
  const dvec3 rolled = about_x(a.roll) * end;
  if (std::hypot(target.x, target.z) > 0)
    a.pitch = pitch.clamp(wrapped(std::atan2(target.x, target.z) - std::atan2(rolled.x, rolled.z)));
  a.miss = glm::length(about_y(a.pitch) * rolled - target);
  return a;
}

}  // namespace moomill
