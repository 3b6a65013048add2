#pragma once
// Are the individuals of a breed different animals, and do they vary as the breed does?
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "generator/core/math.h"
#include "validate/studies/study.h"

namespace moomill {

struct IndividualsRequest {
  std::string species = "cow", breed = "holstein";
  int count = 10000;
  std::uint64_t seed = 0;
};

// Colours of individuals at the same points of the surface, each point for the same area.
struct SampledHerd {
  int points = 0;
  std::vector<std::array<float, 3>> lab;  // [individual][point], CIE 1976 L*a*b*
  int size() const { return points > 0 ? static_cast<int>(lab.size() / points) : 0; }
  std::span<const std::array<float, 3>> of(int i) const {
    return {lab.data() + static_cast<std::size_t>(i) * points, static_cast<std::size_t>(points)};
  }
};

// How far every animal is from its nearest neighbour: the share of the surface that differs by CIEDE2000 above 20.
// Exact wherever it is below `bar`; above it a proven lower bound, which is at least `bar`.
struct Neighbours {
  std::vector<double> share;          // per individual
  double light = 0, dark = 0;         // L*: points below `dark` and above `light` differ by more than 20 for certain
  std::uint64_t pairs = 0, exact = 0;  // pairs in all; those that needed CIEDE2000 itself
};

// By bits: a point is dark (L* below a), light (L* above a + 35) or neither. Of a dark and a light point CIEDE2000 is
// at least dL / S_L with S_L at most 1.75, as its chroma and hue terms are a positive form (|R_T| < 2); so the count of
// such points, two population counts a word, bounds the share from below. Pairs that the bound leaves below `bar` are
// compared by CIEDE2000 at every point. Parallel, deterministic.
Neighbours nearest_neighbours(const SampledHerd& herd, double bar);

// The statistics of a breed and the distinctness of `count` individuals, held to: 99.5 % differ from their nearest
// neighbour on at least 5 % of the surface.
StudyResult individuals_study(const IndividualsRequest& request);

}  // namespace moomill
