#pragma once
// What the light at a surface's vertices is: computed once per pose, looked up by every path of every view.
#include <vector>

#include "generator/render/accel.h"
#include "generator/render/light.h"

namespace moomill {

// Per instance and vertex: the share of the cosine-weighted hemisphere around its normal from which nothing is met, [0, 1], from 16 rays.
// A guess good enough to steer by; nothing expected of a picture depends on it.
using SkyShares = std::vector<std::vector<float>>;
SkyShares sky_shares(const Scene& scene, const Accel& accel);

// Light held by the vertices of the animals, in every coat of the scene, for pictures that trade a small bias for time.
//
// Incident, for the matt base (Bsdf): I(n) = integral of L(wi) (1 - Ed(n.wi)) (n.wi) over what the vertex sees, without the lights
// that paths sample (suns, rectangles, bright parts of maps). It depends on the shading normal n as
// I = c0 + c1 x + c2 y + c3 (x^2 + y^2) with x, y its components in Frame(vertex normal), fitted at n and at normals 20 degrees off it.
// Outgoing: radiance thrown back, all lights included, alike in all directions.
// Between vertices both are interpolated. Light between the animals' surfaces is solved for by iteration (radiosity), light
// by way of other surfaces is traced.
struct SurfaceLight {
  int padded = 0;  // coats, as path_kernel.h pads them; a value is [channel][padded coat]
  struct Held {
    std::vector<float> incident;  // vertex, c0 to c3, channel, padded coat; empty: this instance holds none
    std::vector<float> outgoing;  // vertex, channel, padded coat
  };
  std::vector<Held> instances;

  bool holds(std::uint32_t instance) const { return !instances[instance].incident.empty(); }
  const float* incident(std::uint32_t instance, std::uint32_t vertex) const { return &instances[instance].incident[std::size_t{12} * padded * vertex]; }
  const float* outgoing(std::uint32_t instance, std::uint32_t vertex) const { return &instances[instance].outgoing[std::size_t{3} * padded * vertex]; }
};

// Gathers it with 256 rays a vertex. Instances with a metal, whose light is not alike in all directions, hold none, nor does scenery.
SurfaceLight gather_light(const Scene& scene, const Lights& lights, const Accel& accel);

// Coats as path_kernel.h pads them, and a call with that number as a constant.
inline constexpr int most_coats = 128;
constexpr int padded_coats(int coats) { return coats <= 8 ? 8 : coats <= 16 ? 16 : coats <= 32 ? 32 : coats <= 64 ? 64 : most_coats; }
template <class Body>
void with_padded_coats(int coats, const Body& body) {
  switch (padded_coats(coats)) {
    case 8: return body.template operator()<8>();
    case 16: return body.template operator()<16>();
    case 32: return body.template operator()<32>();
    case 64: return body.template operator()<64>();
    default: return body.template operator()<most_coats>();
  }
}

}  // namespace moomill
