#pragma once
// What the light at a surface's vertices is: computed once per pose, looked up by every path of every view.
#include <vector>

#include "generator/render/accel.h"

namespace moomill {

// Per instance and vertex: the share of the cosine-weighted hemisphere around its normal from which nothing is met, [0, 1], from 16 rays.
// A guess good enough to steer by; nothing expected of a picture depends on it.
using SkyShares = std::vector<std::vector<float>>;
SkyShares sky_shares(const Scene& scene, const Accel& accel);

}  // namespace moomill
