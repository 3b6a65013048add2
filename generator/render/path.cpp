#include "generator/render/path.h"

#include <atomic>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/render/bsdf.h"
#include "generator/render/sampler.h"

namespace moomill {
namespace {

constexpr int tile = 16;  // pixels
constexpr float survive_at_most = 0.8f;

// Pairs of dimensions of a path: one for the filter, then a block per bounce.
enum Pair : std::uint32_t { filter_pair = 0, direction_pair, lobe_pair, light_pair, choice_pair, texel_pair, pairs_per_bounce = 5 };

// One value per coat and channel, padded to a multiple of four coats so that the loops are whole vectors.
template <int P>
struct alignas(32) Lanes {
  float v[3][P];
  void fill(float x) {
    for (auto& c : v)
      for (float& e : c) e = x;
  }
};

// Everything about the point a ray has met.
struct ShadingPoint {
  vec3 position{0};          // relative to the scene origin
  vec3 geometric{0, 0, 1};   // unit, towards the side the ray came from
  vec3 shading{0, 0, 1};     // unit, same side
  vec2 uv{0};
  vec3 vertex_color{1};
  const Material* material = nullptr;
};

// False for a triangle without area: it reflects nothing.
bool shading_point(const Scene& scene, const SurfaceHit& hit, const vec3& wo, ShadingPoint& out) {
  const Instance& in = scene.instances[hit.instance];
  const Surface& s = *in.surface;
  const uvec3 t = s.triangles[hit.triangle];
  const vec3 p0 = in.posed.positions[t[0]], e1 = in.posed.positions[t[1]] - p0, e2 = in.posed.positions[t[2]] - p0;
  const vec3 cross = glm::cross(e1, e2);
  const float area2 = glm::length(cross);
  if (!(area2 > 1e-20f)) return false;
  const float u = hit.u, v = hit.v, w = 1.0f - u - v;
  out.position = p0 + u * e1 + v * e2;
  out.geometric = cross / area2;
  vec3 n = w * in.posed.normals[t[0]] + u * in.posed.normals[t[1]] + v * in.posed.normals[t[2]];
  const float length = glm::length(n);
  n = length > 1e-6f ? n / length : out.geometric;
  out.uv = s.uvs.empty() ? vec2(0) : w * s.uvs[t[0]] + u * s.uvs[t[1]] + v * s.uvs[t[2]];
  if (!s.colors.empty()) out.vertex_color = w * s.colors[t[0]] + u * s.colors[t[1]] + v * s.colors[t[2]];
  const Material& m = scene.material(in, hit.triangle);
  out.material = &m;

  if (m.normal_texture >= 0 && !s.uvs.empty()) {
    // Tangent x along u of the triangle's UVs, made perpendicular to the shading normal; y on the side of -v, where glTF's
    // green points.
    const vec2 d1 = s.uvs[t[1]] - s.uvs[t[0]], d2 = s.uvs[t[2]] - s.uvs[t[0]];
    const float det = d1.x * d2.y - d1.y * d2.x;
    const vec3 along_u = (e1 * d2.y - e2 * d1.y) * (det < 0 ? -1.0f : 1.0f);
    const vec3 tangent = along_u - n * glm::dot(n, along_u);
    const float tl = glm::length(tangent);
    if (det != 0 && tl > 1e-12f) {
      const vec3 x = tangent / tl;
      const vec3 y = glm::cross(n, x) * (det < 0 ? 1.0f : -1.0f);
      const Texture& tex = *scene.appearance->textures[m.normal_texture];
      vec3 local(2 * texture_value(tex, out.uv, 0) - 1, 2 * texture_value(tex, out.uv, 1) - 1, 2 * texture_value(tex, out.uv, 2) - 1);
      local.x *= m.normal_scale;
      local.y *= m.normal_scale;
      const vec3 bent = local.x * x + local.y * y + local.z * n;
      const float bl = glm::length(bent);
      if (bl > 1e-6f) n = bent / bl;
    }
  }
  if (glm::dot(out.geometric, wo) < 0) out.geometric = -out.geometric;
  if (glm::dot(out.geometric, n) < 0) n = -n;
  // A shading normal that faces away from the ray would leave nothing to see: lean it just far enough.
  const float facing = glm::dot(n, wo);
  if (facing < 0.02f) n = glm::normalize(n + (0.02f - facing) * wo);
  out.shading = n;
  return true;
}

// Where a ray leaving a surface starts: off it by more than the rounding of the hit point.
vec3 leave(const ShadingPoint& p, const vec3& direction) {
  const vec3 a = glm::abs(p.position);
  const float offset = 4e-6f * std::max(1.0f, std::max({a.x, a.y, a.z}));
  return p.position + (glm::dot(direction, p.geometric) < 0 ? -offset : offset) * p.geometric;
}

// f(t) = A + B b + C b^2 per coat and channel, times a weight.
template <int P>
void multiply(Lanes<P>& out, const Lanes<P>& in, const Lanes<P>& base, const BaseResponse& r, float weight) {
  const float a = r.a * weight, b = r.b * weight, c = r.c * weight;
  for (int k = 0; k < 3; ++k)
    for (int t = 0; t < P; ++t) out.v[k][t] = in.v[k][t] * (a + base.v[k][t] * (b + base.v[k][t] * c));
}
template <int P>
void add(Lanes<P>& sum, const Lanes<P>& throughput, const vec3& radiance) {
  for (int k = 0; k < 3; ++k) {
    const float e = radiance[k];
    for (int t = 0; t < P; ++t) sum.v[k][t] += throughput.v[k][t] * e;
  }
}

struct Counters {
  std::uint64_t paths = 0, rays = 0, not_finite = 0;
};

// Radiance along one camera ray that has met `hit`. The estimator per bounce, in solid angle:
//   lights:  Le f cos / p_light * w_light      (next-event estimation)
//   BSDF:    Le f cos / p_bsdf  * w_bsdf       (when the sampled ray meets light)
// with power-heuristic weights. Every decision is as for a white base, so the paths are those of every coat.
template <int P>
void trace_path(const Scene& scene, const Lights& lights, const Accel& accel, const PathOptions& options, const PixelSampler& sampler,
                std::uint32_t sample, SurfaceHit hit, vec3 wo, Lanes<P>& radiance, Counters& counters) {
  Lanes<P> throughput, base, reflected;
  throughput.fill(1.0f);
  base.fill(0.0f);
  float white = 1.0f;  // throughput of a white base
  for (int bounce = 0;; ++bounce) {
    ShadingPoint point;
    if (!shading_point(scene, hit, wo, point)) return;
    const std::uint32_t block = bounce * pairs_per_bounce;
    const Material& m = *point.material;
    fetch_paint(*scene.appearance->paints[m.paint], scene.appearance->textures, point.uv, point.vertex_color, sampler.get(block + texel_pair, sample), P, &base.v[0][0]);
    float roughness = m.roughness, metallic = m.metallic;
    if (m.metallic_roughness_texture >= 0) {
      roughness *= texture_value(*scene.appearance->textures[m.metallic_roughness_texture], point.uv, 1);
      metallic *= texture_value(*scene.appearance->textures[m.metallic_roughness_texture], point.uv, 2);
    }
    const Frame frame(point.shading);
    const Bsdf bsdf(roughness, metallic, frame.to_local(wo), m.specular);

    const vec2 choice = sampler.get(block + choice_pair, sample);
    if (lights.count() > 0) {
      const LightSample light = lights.sample(point.position, choice.x, sampler.get(block + light_pair, sample));
      if (light.pdf > 0 && light.radiance != vec3(0) && glm::dot(light.direction, point.geometric) > 0) {
        const vec3 wi = frame.to_local(light.direction);
        const BaseResponse f = bsdf.evaluate(wi);
        if (f.white() > 0) {
          Ray shadow{leave(point, light.direction), 0, light.direction, light.distance * (1 - 1e-5f)};
          ++counters.rays;
          if (!accel.occluded(shadow)) {
            multiply(reflected, throughput, base, f, power_heuristic(light.pdf, bsdf.pdf(wi)) / light.pdf);
            add(radiance, reflected, light.radiance);
          }
        }
      }
    }

    const vec2 lobe = sampler.get(block + lobe_pair, sample);
    const BsdfSample s = bsdf.sample(sampler.get(block + direction_pair, sample), lobe.x);
    if (!(s.pdf > 0)) return;
    const vec3 direction = frame.to_world(s.wi);
    if (glm::dot(direction, point.geometric) <= 0) return;  // under the true surface
    const BaseResponse f = bsdf.evaluate(s.wi);
    multiply(throughput, throughput, base, f, 1.0f / s.pdf);
    white *= f.white() / s.pdf;
    const vec3 from = leave(point, direction);
    hit = accel.intersect({from, 0, direction, std::numeric_limits<float>::infinity()});
    ++counters.rays;
    const float distance = hit.valid() ? hit.t : std::numeric_limits<float>::infinity();
    const vec3 light = lights.seen_by_bsdf_ray(from, direction, s.pdf, distance);
    if (light != vec3(0)) add(radiance, throughput, light);
    if (!hit.valid()) return;
    if (options.max_bounces > 0 && bounce + 1 >= options.max_bounces) return;
    if (bounce + 1 >= options.roulette_from) {
      const float survive = std::min(survive_at_most, white);
      if (!(lobe.y < survive)) return;
      const float gain = 1.0f / survive;
      for (auto& c : throughput.v)
        for (float& t : c) t *= gain;
      white *= gain;
    }
    wo = -direction;
  }
}

// All samples of one pixel.
template <int P>
void trace_pixel(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera, const PathOptions& options,
                 const PixelFilter& filter, int x, int y, Lanes<P>& mean, float& alpha, Counters& counters) {
  const PixelSampler sampler(options.stream, static_cast<std::uint64_t>(y) * camera.width + x);
  const vec3 origin(camera.centre - scene.origin);
  mean.fill(0.0f);
  Lanes<P> lost;  // what the sums so far have lost to rounding (Kahan 1965): a plain sum of a million samples is 1 % off
  lost.fill(0.0f);
  int seen = 0;
  for (int first = 0; first < options.samples; first += 8) {
    const int n = std::min(8, options.samples - first);
    Ray8 rays;
    vec3 direction[8];
    for (int i = 0; i < 8; ++i) {
      const vec2 xi = sampler.get(filter_pair, first + i);
      const dvec3 d = camera.direction(x + 0.5 + filter.sample(xi.x), y + 0.5 + filter.sample(xi.y));
      direction[i] = vec3(glm::normalize(d));
      rays.ox[i] = origin.x, rays.oy[i] = origin.y, rays.oz[i] = origin.z;
      rays.dx[i] = direction[i].x, rays.dy[i] = direction[i].y, rays.dz[i] = direction[i].z;
      rays.near[i] = 0;
      rays.far[i] = std::numeric_limits<float>::infinity();
      rays.active[i] = i < n;
    }
    accel.intersect8(rays, true);
    counters.paths += n;
    counters.rays += n;
    for (int i = 0; i < n; ++i) {
      Lanes<P> radiance;
      radiance.fill(0.0f);
      if (rays.instance[i] == no_hit) {
        if (!options.environment_visible) continue;
        ++seen;
        Lanes<P> one;
        one.fill(1.0f);
        add(radiance, one, lights.environment->radiance(direction[i]));
      } else {
        ++seen;
        const SurfaceHit hit{rays.instance[i], rays.triangle[i], rays.u[i], rays.v[i], rays.far[i]};
        trace_path(scene, lights, accel, options, sampler, first + i, hit, -direction[i], radiance, counters);
      }
      float total = 0;
      for (auto& c : radiance.v)
        for (float t : c) total += t;
      if (!std::isfinite(total)) {
        ++counters.not_finite;
        continue;
      }
      for (int k = 0; k < 3; ++k)
        for (int t = 0; t < P; ++t) {
          const float e = radiance.v[k][t] - lost.v[k][t], sum = mean.v[k][t] + e;
          lost.v[k][t] = (sum - mean.v[k][t]) - e;
          mean.v[k][t] = sum;
        }
    }
  }
  const float scale = 1.0f / options.samples;
  for (auto& c : mean.v)
    for (float& t : c) t *= scale;
  alpha = seen * scale;
}

template <int P>
void trace_tiles(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera, const PixelMask& mask,
                 const PathOptions& options, Radiance& out) {
  const PixelFilter filter(options.filter_radius);
  const int tiles_x = (camera.width + tile - 1) / tile, tiles_y = (camera.height + tile - 1) / tile;
  std::atomic<std::uint64_t> paths{0}, rays{0}, not_finite{0};
  parallel_for(static_cast<std::size_t>(tiles_x) * tiles_y, 1, [&](std::size_t index) {
    const int x0 = static_cast<int>(index % tiles_x) * tile, y0 = static_cast<int>(index / tiles_x) * tile;
    Counters counters;
    for (int y = y0; y < std::min(y0 + tile, camera.height); ++y)
      for (int x = x0; x < std::min(x0 + tile, camera.width); ++x) {
        if (!mask.get(x, y)) continue;
        Lanes<P> mean;
        float alpha;
        trace_pixel(scene, lights, accel, camera, options, filter, x, y, mean, alpha, counters);
        for (std::size_t t = 0; t < out.coats.size(); ++t) {
          float* p = &out.coats[t].data[out.coats[t].index(x, y)];
          for (int k = 0; k < 3; ++k) p[k] = mean.v[k][t];
          p[3] = alpha;
        }
      }
    paths += counters.paths;
    rays += counters.rays;
    not_finite += counters.not_finite;
  });
  out.paths = paths;
  out.rays = rays;
  out.not_finite = not_finite;
}

}  // namespace

PixelFilter::PixelFilter(double radius) {
  // Harris 1978, four-term Blackman-Harris window, integrated and inverted by a table.
  constexpr int n = 1024;
  std::vector<double> cumulative(n + 1, 0.0);
  for (int i = 0; i < n; ++i) {
    const double x = (i + 0.5) / n, a = 2 * pi * x;
    cumulative[i + 1] = cumulative[i] + 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a);
  }
  inverse_.resize(n + 1);
  int k = 0;
  for (int i = 0; i <= n; ++i) {
    const double target = cumulative[n] * i / n;
    while (k < n - 1 && cumulative[k + 1] < target) ++k;
    const double width = cumulative[k + 1] - cumulative[k];
    const double x = (k + (width > 0 ? std::clamp((target - cumulative[k]) / width, 0.0, 1.0) : 0.0)) / n;
    inverse_[i] = static_cast<float>((2 * x - 1) * radius);
  }
}

float PixelFilter::sample(float xi) const {
  const float x = xi * (inverse_.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(x), inverse_.size() - 2);
  return inverse_[i] + (x - static_cast<float>(i)) * (inverse_[i + 1] - inverse_[i]);
}

Radiance trace_radiance(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera, const PixelMask& mask,
                        const PathOptions& options) {
  Radiance out;
  out.coats.assign(scene.appearance->coat_count, ImageF(camera.width, camera.height, 4));
  check(scene.appearance->coat_count >= 1 && scene.appearance->coat_count <= 32, "a batch holds 1 to 32 coats");
  check(options.samples >= 1, "at least one sample a pixel");
  for (const auto& p : scene.appearance->paints) check(static_cast<int>(p->coats.size()) == scene.appearance->coat_count, "a paint has another number of coats");
  if (scene.appearance->coat_count <= 1)
    trace_tiles<1>(scene, lights, accel, camera, mask, options, out);
  else if (scene.appearance->coat_count <= 4)
    trace_tiles<4>(scene, lights, accel, camera, mask, options, out);
  else if (scene.appearance->coat_count <= 12)
    trace_tiles<12>(scene, lights, accel, camera, mask, options, out);
  else
    trace_tiles<32>(scene, lights, accel, camera, mask, options, out);
  return out;
}

}  // namespace moomill
