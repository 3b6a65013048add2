#include "generator/render/surface_light.h"

#include "generator/core/parallel.h"
#include "generator/render/bsdf.h"
#include "generator/render/sampler.h"

namespace moomill {
namespace {

constexpr std::uint64_t sky_stream = 0x736b79;  // any constant: the vertices' rays are the same in every frame
constexpr int sky_rays = 16;

// Off the surface by more than the rounding of a vertex.
vec3 off_surface(const vec3& position, const vec3& normal) {
  const vec3 a = glm::abs(position);
  return position + 4e-6f * std::max(1.0f, std::max({a.x, a.y, a.z})) * normal;
}

}  // namespace

SkyShares sky_shares(const Scene& scene, const Accel& accel) {
  SkyShares out(scene.instances.size());
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const PosedSurface& posed = scene.instances[i].posed;
    out[i].assign(posed.positions.size(), 0.0f);
    parallel_for(posed.positions.size(), 256, [&](std::size_t v) {
      const float length = glm::length(posed.normals[v]);
      if (!(length > 1e-6f)) return;  // of no face: sees nothing
      const Frame frame(posed.normals[v] / length);
      const vec3 from = off_surface(posed.positions[v], frame.z);
      const PixelSampler sampler(sky_stream, v);
      int open = 0;
      for (int first = 0; first < sky_rays; first += 8) {
        vec2 u[8];
        sampler.get8(0, first, u);
        Ray8 rays;
        for (int k = 0; k < 8; ++k)
          rays.set(k, {from, 0, frame.to_world(sample_cosine_hemisphere(u[k])), std::numeric_limits<float>::infinity()}, true);
        accel.occluded8(rays, false);
        for (int k = 0; k < 8; ++k) open += rays.instance[k] == no_hit;
      }
      out[i][v] = static_cast<float>(open) / sky_rays;
    });
  }
  return out;
}

}  // namespace moomill
