#pragma once
// Noise over space, keyed by a seed: integers and basic arithmetic only, so it is the same on every machine.
#include <cstdint>

#include "generator/core/math.h"

namespace moomill {

// Hash of a lattice cell.
std::uint32_t hash_cell(int x, int y, int z, std::uint32_t seed);

// Gradient noise (Perlin 2002: quintic fade, twelve edge directions) in about [-1, 1], mean 0, standard deviation
// about 0.27; features are about one unit large.
double gradient_noise(const dvec3& p, std::uint32_t seed);

}  // namespace moomill
