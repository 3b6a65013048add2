#pragma once
// A smooth map of space through given points: the thin-plate spline (Bookstein 1989), in three dimensions with the
// kernel r, which minimises the bending energy there.
#include <vector>

#include "generator/core/math.h"

namespace moomill {

struct Warp {
  std::vector<dvec3> centres, weights;
  dmat3 linear{1.0};
  dvec3 shift{0};
  dvec3 apply(const dvec3& p) const;
};

// Takes every `from` to its `to` (within rounding). False where the points do not span space.
bool fit_warp(const std::vector<dvec3>& from, const std::vector<dvec3>& to, Warp& warp);

}  // namespace moomill
