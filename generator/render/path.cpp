#include "generator/render/path.h"

#include <atomic>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/render/bsdf.h"
#include "generator/render/sampler.h"

namespace moomill {
namespace {

constexpr int tile = 16;  // pixels
constexpr int batch_size = 8;  // samples of a pixel that go side by side
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
  float sky = 0;  // guess of the share of the sky it sees
};

// False for a triangle without area: it reflects nothing.
bool shading_point(const Scene& scene, const SkyShares* sky, const SurfaceHit& hit, const vec3& wo, ShadingPoint& out) {
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
  // Guessed for the side that the normals point to.
  if (sky && (glm::dot(out.geometric, wo) > 0) == (glm::dot(out.geometric, n) > 0)) {
    const std::vector<float>& share = (*sky)[hit.instance];
    out.sky = w * share[t[0]] + u * share[t[1]] + v * share[t[2]];
  }
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
      vec3 local = 2.0f * texture_rgb(*scene.appearance->textures[m.normal_texture], out.uv) - 1.0f;
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

// Eight samples of one pixel on their way through the scene. A lane is at work while it is in `lanes`.
template <int P>
struct Batch {
  Lanes<P> throughput[batch_size], radiance[batch_size];
  float white[batch_size];  // throughput of a white base
  SurfaceHit hit[batch_size];
  vec3 wo[batch_size];
  int lanes[batch_size], count = 0;
};

// What one image is traced with.
struct Tracer {
  const Scene& scene;
  const Lights& lights;
  const Accel& accel;
  const PathOptions& options;
};

// Whether each of `count` shadow rays meets something; the first of them coherent or not.
void occluded_rays(const Accel& accel, const Ray* rays, int count, bool coherent, bool* occluded) {
  if (count <= 2) {
    for (int i = 0; i < count; ++i) occluded[i] = accel.occluded(rays[i]);
    return;
  }
  Ray8 packet;
  for (int i = 0; i < batch_size; ++i) packet.set(i, rays[std::min(i, count - 1)], i < count);
  accel.occluded8(packet, coherent);
  for (int i = 0; i < count; ++i) occluded[i] = packet.instance[i] != no_hit;
}

void intersect_rays(const Accel& accel, const Ray* rays, int count, SurfaceHit* hits) {
  for (int i = 0; i < count; ++i) hits[i] = accel.intersect(rays[i]);
}

// Radiance along camera rays that have met the batch's hits. The estimator per bounce, in solid angle:
//   lights:  Le f cos / p_light * w_light      (next-event estimation)
//   BSDF:    Le f cos / p_bsdf  * w_bsdf       (when the sampled ray meets light)
// with power-heuristic weights. Every decision is as for a white base, so the paths are those of every coat.
//
// An even sky is a control variate: what it would give an open surface, albedo(wo) Le, is known, and f cos / p Le of any BSDF
// sample, wherever it goes, estimates it. The former is added and the latter taken away, as much of both as the point sees of
// the sky by a guess: the expectation stays, and where the sky is open the scatter of f cos / p goes. An estimate may be below 0.
template <int P>
void trace_paths(const Tracer& t, const PixelSampler& sampler, std::uint32_t first, Batch<P>& batch, Counters& counters) {
  Lanes<P> base[batch_size], reflected;
  ShadingPoint point[batch_size];
  const vec3 even = t.lights.environment->is_map() ? vec3(0) : t.lights.environment->mean_radiance();
  const SkyShares* sky = even == vec3(0) ? nullptr : t.options.sky;
  Frame frame[batch_size];
  Bsdf bsdf[batch_size];
  for (int l = 0; l < batch_size; ++l) base[l].fill(0.0f);
  for (int bounce = 0; batch.count > 0; ++bounce) {
    const std::uint32_t block = bounce * pairs_per_bounce;
    vec2 texel_u[batch_size], choice_u[batch_size], light_u[batch_size], lobe_u[batch_size], direction_u[batch_size];
    sampler.get8(block + texel_pair, first, texel_u);
    sampler.get8(block + lobe_pair, first, lobe_u);
    sampler.get8(block + direction_pair, first, direction_u);
    if (t.lights.count() > 0) {
      sampler.get8(block + choice_pair, first, choice_u);
      sampler.get8(block + light_pair, first, light_u);
    }

    Ray rays[batch_size];
    int of[batch_size], count = 0;  // the lane of each ray
    float weight[batch_size];
    vec3 light_radiance[batch_size];
    BaseResponse response[batch_size];
    int alive = 0;
    for (int i = 0; i < batch.count; ++i) {
      const int l = batch.lanes[i];
      ShadingPoint& p = point[l];
      p = {};
      if (!shading_point(t.scene, sky, batch.hit[l], batch.wo[l], p)) continue;
      batch.lanes[alive++] = l;
      const Material& m = *p.material;
      const auto& textures = t.scene.appearance->textures;
      fetch_paint(*t.scene.appearance->paints[m.paint], textures, p.uv, p.vertex_color, texel_u[l], P, &base[l].v[0][0]);
      float roughness = m.roughness, metallic = m.metallic;
      if (m.metallic_roughness_texture >= 0) {
        const vec3 texel = texture_rgb(*textures[m.metallic_roughness_texture], p.uv);
        roughness *= texel.y;
        metallic *= texel.z;
      }
      frame[l] = Frame(p.shading);
      // What the camera sees of a dark coat is mostly highlight; after the first bounce most of the light is what light coats throw.
      bsdf[l] = Bsdf(roughness, metallic, frame[l].to_local(batch.wo[l]), m.specular, bounce > 0 ? 0.02f : sky ? 0.35f : 0.15f);
      if (!bsdf[l].albedo_is_known()) p.sky = 0;
      if (p.sky > 0) {
        multiply(reflected, batch.throughput[l], base[l], bsdf[l].albedo(), p.sky);
        add(batch.radiance[l], reflected, even);
      }
      if (t.lights.count() == 0) continue;
      const LightSample light = t.lights.sample(p.position, choice_u[l].x, light_u[l]);
      if (!(light.pdf > 0) || light.radiance == vec3(0) || !(glm::dot(light.direction, p.geometric) > 0)) continue;
      const Bsdf::Value f = bsdf[l].value(frame[l].to_local(light.direction));
      if (!(f.response.white() > 0)) continue;
      rays[count] = {leave(p, light.direction), 0, light.direction, light.distance * (1 - 1e-5f)};
      weight[count] = power_heuristic(light.pdf, f.pdf) / light.pdf;
      light_radiance[count] = light.radiance;
      response[count] = f.response;
      of[count++] = l;
    }
    batch.count = alive;
    bool occluded[batch_size];
    occluded_rays(t.accel, rays, count, bounce == 0, occluded);
    counters.rays += count;
    for (int i = 0; i < count; ++i) {
      if (occluded[i]) continue;
      const int l = of[i];
      multiply(reflected, batch.throughput[l], base[l], response[i], weight[i]);
      add(batch.radiance[l], reflected, light_radiance[i]);
    }

    float pdf[batch_size];
    count = 0;
    for (int i = 0; i < batch.count; ++i) {
      const int l = batch.lanes[i];
      vec3 wi;
      if (!bsdf[l].sample_direction(direction_u[l], lobe_u[l].x, wi)) continue;
      const Bsdf::Value f = bsdf[l].value(wi);
      if (!(f.pdf > 0)) continue;
      const vec3 direction = frame[l].to_world(wi);
      const bool under = glm::dot(direction, point[l].geometric) <= 0;  // the true surface
      multiply(batch.throughput[l], batch.throughput[l], base[l], f.response, 1.0f / f.pdf);
      batch.white[l] *= f.response.white() / f.pdf;
      if (point[l].sky > 0) add(batch.radiance[l], batch.throughput[l], -point[l].sky * even);
      if (under) continue;
      rays[count] = {leave(point[l], direction), 0, direction, std::numeric_limits<float>::infinity()};
      pdf[count] = f.pdf;
      of[count++] = l;
    }
    SurfaceHit hits[batch_size];
    intersect_rays(t.accel, rays, count, hits);
    counters.rays += count;
    alive = 0;
    for (int i = 0; i < count; ++i) {
      const int l = of[i];
      const bool met = hits[i].valid();
      const vec3 light = t.lights.seen_by_bsdf_ray(rays[i].origin, rays[i].direction, pdf[i], met ? hits[i].t : std::numeric_limits<float>::infinity());
      if (light != vec3(0)) add(batch.radiance[l], batch.throughput[l], light);
      if (!met || (t.options.max_bounces > 0 && bounce + 1 >= t.options.max_bounces)) continue;
      if (bounce + 1 >= t.options.roulette_from) {
        const float survive = std::min(survive_at_most, batch.white[l]);
        if (!(lobe_u[l].y < survive)) continue;
        const float gain = 1.0f / survive;
        for (auto& c : batch.throughput[l].v)
          for (float& v : c) v *= gain;
        batch.white[l] *= gain;
      }
      batch.hit[l] = hits[i];
      batch.wo[l] = -rays[i].direction;
      batch.lanes[alive++] = l;
    }
    batch.count = alive;
  }
}

// Where the samples of every pixel lie within it, and what they count in the pixels around. All pixels of an image have
// the same places: so the weights of the samples that reach a pixel add up alike everywhere, and dividing by their sum, which
// keeps even areas even at any number of samples, is a constant factor that tends to 1.
struct SamplePlaces {
  int reach;                   // pixels each way
  std::vector<vec2> position;  // per sample: within the pixel, [0, 1)^2; around its centre where reach is 0
  std::vector<float> weight;   // per sample: of columns -reach .. reach, then of rows

  SamplePlaces(const PixelFilter& filter, std::uint64_t stream, int samples) : reach(filter.reach()), position(samples) {
    const PixelSampler sampler(stream, ~0ull);
    const int side = 2 * reach + 1;
    weight.assign(2 * side * static_cast<std::size_t>(samples), 1.0f);
    double total = 0;
    for (int s = 0; s < samples; ++s) {
      const vec2 u = sampler.get(filter_pair, s);
      position[s] = reach > 0 ? u : vec2(0.5f + filter.sample(u.x), 0.5f + filter.sample(u.y));
      if (reach == 0) continue;
      double sum[2] = {0, 0};
      for (int axis = 0; axis < 2; ++axis)
        for (int k = 0; k < side; ++k) {
          const float w = filter.weight(std::abs(position[s][axis] - 0.5f - static_cast<float>(k - reach)));
          weight[(2 * static_cast<std::size_t>(s) + axis) * side + k] = w;
          sum[axis] += w;
        }
      total += sum[0] * sum[1] / samples;
    }
    if (reach > 0)
      for (float& w : weight) w /= static_cast<float>(std::sqrt(total));
  }
  const float* of(int sample) const { return &weight[2 * static_cast<std::size_t>(sample) * (2 * reach + 1)]; }
};

// Sums of a pixel, with what they have lost to rounding so far (Kahan 1965): a plain sum of a million samples is 1 % off.
template <int P>
struct PixelSums {
  static constexpr int values = 3 * P + 1;  // radiance as in Lanes, then alpha
  float sum[values] = {}, lost[values] = {};
  void add(const float* more) {
    for (int i = 0; i < values; ++i) {
      const float e = more[i] - lost[i], s = sum[i] + e;
      lost[i] = (s - sum[i]) - e;
      sum[i] = s;
    }
  }
};

// All samples of pixel (x, y), which may lie outside the image, added to the sums around `centre`, a pixel of rows `stride` wide.
template <int P>
void trace_pixel(const Tracer& t, const Camera& camera, const SamplePlaces& places, int x, int y, PixelSums<P>* centre, int stride,
                 Counters& counters) {
  const PathOptions& options = t.options;
  const PixelSampler sampler = PixelSampler::in_image(options.stream, x + places.reach, y + places.reach, options.samples);
  const vec3 origin(camera.centre - t.scene.origin);
  Batch<P> batch;
  for (int first = 0; first < options.samples; first += batch_size) {
    const int n = std::min(batch_size, options.samples - first);
    Ray8 rays;
    vec3 direction[batch_size];
    for (int i = 0; i < batch_size; ++i) {
      const vec2 at = places.position[std::min(first + i, options.samples - 1)];
      direction[i] = vec3(glm::normalize(camera.direction(static_cast<double>(x) + at.x, static_cast<double>(y) + at.y)));
      rays.set(i, {origin, 0, direction[i], std::numeric_limits<float>::infinity()}, i < n);
    }
    t.accel.intersect8(rays, true);
    counters.paths += n;
    counters.rays += n;
    bool seen[batch_size] = {};
    int any = 0;
    batch.count = 0;
    for (int i = 0; i < n; ++i) {
      const bool met = rays.instance[i] != no_hit;
      if (!met && !options.environment_visible) continue;
      seen[i] = true;
      ++any;
      batch.radiance[i].fill(0.0f);
      batch.throughput[i].fill(1.0f);
      if (!met) {
        add(batch.radiance[i], batch.throughput[i], t.lights.environment->radiance(direction[i]));
        continue;
      }
      batch.white[i] = 1.0f;
      batch.hit[i] = {rays.instance[i], rays.triangle[i], rays.u[i], rays.v[i], rays.far[i]};
      batch.wo[i] = -direction[i];
      batch.lanes[batch.count++] = i;
    }
    if (any == 0) continue;
    trace_paths(t, sampler, first, batch, counters);

    for (int i = 0; i < n; ++i) {
      if (!seen[i]) continue;
      float total = 0;
      for (auto& c : batch.radiance[i].v)
        for (float v : c) total += v;
      if (std::isfinite(total)) continue;
      ++counters.not_finite;
      batch.radiance[i].fill(0.0f);
    }
    const int side = 2 * places.reach + 1;
    for (int row = 0; row < side; ++row)
      for (int column = 0; column < side; ++column) {
        alignas(32) float part[PixelSums<P>::values] = {};
        for (int i = 0; i < n; ++i) {
          if (!seen[i]) continue;
          const float* w = places.of(first + i);
          const float weight = w[column] * w[side + row];
          const float* values = &batch.radiance[i].v[0][0];
          for (int k = 0; k < 3 * P; ++k) part[k] += weight * values[k];
          part[3 * P] += weight;
        }
        centre[(row - places.reach) * stride + column - places.reach].add(part);
      }
  }
}

// Pixels within `reach` of those in the mask; pixel (x, y) of it is (x - reach, y - reach) of the image.
PixelMask within_reach(const PixelMask& mask, int reach) {
  PixelMask out(mask.width + 2 * reach, mask.height + 2 * reach);
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width;) {
      if (!mask.get(x, y)) {
        ++x;
        continue;
      }
      const int begin = x;
      while (x < mask.width && mask.get(x, y)) ++x;
      for (int row = y; row <= y + 2 * reach; ++row) out.set_span(row, begin, x - 1 + 2 * reach);
    }
  return out;
}

template <int P>
void trace_tiles(const Tracer& t, const Camera& camera, const PixelMask& mask, Radiance& out) {
  const SamplePlaces places(PixelFilter(t.options.filter_radius), t.options.stream, t.options.samples);
  const int reach = places.reach, width = camera.width + 2 * reach, height = camera.height + 2 * reach;
  const PixelMask traced = within_reach(mask, reach);
  const int tiles_x = (width + tile - 1) / tile, tiles_y = (height + tile - 1) / tile;
  const float scale = 1.0f / t.options.samples;
  std::atomic<std::uint64_t> paths{0}, rays{0}, not_finite{0};
  check(2 * reach <= tile, "a pixel filter reaches at most 8 pixels");
  // A tile adds to pixels up to `reach` around it. Every other tile in both directions at a time: they share no pixel, and the order in
  // which a pixel's parts are added does not depend on threads.
  for (int phase = 0; phase < 4; ++phase) {
    const int across = (tiles_x + 1 - (phase & 1)) / 2, down = (tiles_y + 1 - (phase >> 1)) / 2;
    parallel_for(static_cast<std::size_t>(across) * down, 1, [&](std::size_t index) {
      const int x0 = (2 * static_cast<int>(index % across) + (phase & 1)) * tile, y0 = (2 * static_cast<int>(index / across) + (phase >> 1)) * tile;
      const int stride = tile + 2 * reach;
      std::vector<PixelSums<P>> sums;
      Counters counters;
      for (int y = y0; y < std::min(y0 + tile, height); ++y)
        for (int x = x0; x < std::min(x0 + tile, width); ++x) {
          if (!traced.get(x, y)) continue;
          if (sums.empty()) sums.resize(static_cast<std::size_t>(stride) * stride);
          trace_pixel(t, camera, places, x - reach, y - reach, &sums[(y - y0 + reach) * stride + x - x0 + reach], stride, counters);
        }
      if (sums.empty()) return;
      for (int j = 0; j < stride; ++j)
        for (int i = 0; i < stride; ++i) {
          const int x = x0 + i - 2 * reach, y = y0 + j - 2 * reach;
          if (x < 0 || y < 0 || x >= camera.width || y >= camera.height || !mask.get(x, y)) continue;
          const float* sum = sums[j * stride + i].sum;
          if (sum[3 * P] == 0) continue;  // nothing was seen
          for (std::size_t c = 0; c < out.coats.size(); ++c) {
            float* p = &out.coats[c].data[out.coats[c].index(x, y)];
            for (int k = 0; k < 3; ++k) p[k] += sum[k * P + c] * scale;
            p[3] += sum[3 * P] * scale;
          }
        }
      paths += counters.paths;
      rays += counters.rays;
      not_finite += counters.not_finite;
    });
  }
  out.paths = paths;
  out.rays = rays;
  out.not_finite = not_finite;
}

double blackman_harris(double x) {  // over [0, 1]; Harris 1978, four terms
  const double a = 2 * pi * x;
  return 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a);
}

}  // namespace

PixelFilter::PixelFilter(double radius) : radius_(radius) {
  // Integrated and inverted by a table.
  constexpr int n = 1024;
  std::vector<double> cumulative(n + 1, 0.0);
  for (int i = 0; i < n; ++i) cumulative[i + 1] = cumulative[i] + blackman_harris((i + 0.5) / n);
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

float PixelFilter::weight(float distance) const {
  if (!(distance < radius_)) return 0;
  return static_cast<float>(blackman_harris(0.5 + 0.5 * distance / radius_) / (2 * radius_ * 0.35875));
}

Radiance trace_radiance(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera, const PixelMask& mask,
                        const PathOptions& options) {
  Radiance out;
  out.coats.assign(scene.appearance->coat_count, ImageF(camera.width, camera.height, 4));
  check(scene.appearance->coat_count >= 1 && scene.appearance->coat_count <= 32, "a batch holds 1 to 32 coats");
  check(options.samples >= 1, "at least one sample a pixel");
  for (const auto& p : scene.appearance->paints) check(static_cast<int>(p->coats.size()) == scene.appearance->coat_count, "a paint has another number of coats");
  const Tracer tracer{scene, lights, accel, options};
  if (scene.appearance->coat_count <= 1)
    trace_tiles<1>(tracer, camera, mask, out);
  else if (scene.appearance->coat_count <= 4)
    trace_tiles<4>(tracer, camera, mask, out);
  else if (scene.appearance->coat_count <= 12)
    trace_tiles<12>(tracer, camera, mask, out);
  else
    trace_tiles<32>(tracer, camera, mask, out);
  return out;
}

}  // namespace moomill
