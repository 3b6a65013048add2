#pragma once
// The path kernel, for path.cpp and surface_light.cpp alone: eight paths side by side. No coat enters while they are traced; what each
// does to light is written down, a step per surface, and then played for eight coats at a time, in registers.
#include <immintrin.h>

#include "generator/render/bsdf.h"
#include "generator/render/path.h"
#include "generator/render/sampler.h"

namespace moomill::kernel {

inline constexpr int batch_size = 8;  // samples of a pixel that go side by side
inline constexpr float survive_at_most = 0.8f;
inline constexpr float held_highlights = 0.3f;  // share of samples that follow the highlight of a surface that holds its light

// Pairs of dimensions of a path: one for the filter, then a block per bounce.
enum Pair : std::uint32_t { filter_pair = 0, direction_pair, lobe_pair, light_pair, choice_pair, texel_pair, pairs_per_bounce = 5 };

// One value per coat and channel, padded to a multiple of eight coats so that the loops are whole vectors.
template <int P>
struct alignas(32) Lanes {
  static_assert(P % 8 == 0);
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
  bool front = true;  // met on the side that its normals point to
};

// Cancelling faces may leave a vertex without a normal: nothing is held around it.
inline bool have_normals(const Instance& in, const uvec3& t) {
  for (int k = 0; k < 3; ++k)
    if (!(glm::dot(in.posed.normals[t[k]], in.posed.normals[t[k]]) > 1e-12f)) return false;
  return true;
}

// Whether a surface is met on the side that its normals point to, the one that holds light.
inline bool met_in_front(const Scene& scene, const SurfaceHit& hit, const vec3& wo) {
  const Instance& in = scene.instances[hit.instance];
  const uvec3 t = in.surface->triangles[hit.triangle];
  const vec3 p0 = in.posed.positions[t[0]], face = glm::cross(in.posed.positions[t[1]] - p0, in.posed.positions[t[2]] - p0);
  const vec3 n = (1.0f - hit.u - hit.v) * in.posed.normals[t[0]] + hit.u * in.posed.normals[t[1]] + hit.v * in.posed.normals[t[2]];
  return (glm::dot(face, wo) > 0) == (glm::dot(face, n) > 0) && have_normals(in, t);
}

// False for a triangle without area: it reflects nothing.
inline bool shading_point(const Scene& scene, const SkyShares* sky, const SurfaceHit& hit, const vec3& wo, ShadingPoint& out) {
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
  out.front = (glm::dot(out.geometric, wo) > 0) == (glm::dot(out.geometric, n) > 0) && have_normals(in, t);
  if (sky && out.front) {
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

// Off the surface along its normal, by more than the rounding of a point on it.
inline vec3 off_surface(const vec3& position, const vec3& normal) {
  const vec3 a = glm::abs(position);
  return position + 4e-6f * std::max(1.0f, std::max({a.x, a.y, a.z})) * normal;
}
// Where a ray leaving a surface starts.
inline vec3 leave(const ShadingPoint& p, const vec3& direction) {
  return off_surface(p.position, glm::dot(direction, p.geometric) < 0 ? -p.geometric : p.geometric);
}

struct Counters {
  std::uint64_t paths = 0, rays = 0, not_finite = 0;
};

// What a path does where it meets a surface, for a coat with base colour b:
//   radiance += throughput (before[0] + before[1] b + before[2] b^2)
//   throughput *= next(b)
//   radiance += throughput after
struct Step {
  PaintPoint paint;
  vec3 before[3] = {vec3(0), vec3(0), vec3(0)};
  BaseResponse next;
  vec3 after{0};
  bool goes_on = false;  // else the path ends with `before`

  void light(const BaseResponse& r, const vec3& radiance) {
    before[0] += r.a * radiance;
    before[1] += r.b * radiance;
    before[2] += r.c * radiance;
  }
};

// A path through the scene, as far as all coats share it.
struct Trail {
  vec3 seen{0};             // radiance met by the camera ray itself
  std::vector<Step> steps;  // capacity stays from sample to sample
  // Where the surface holds its light. At the first step: radiance += throughput b factor max(0, sum of weight * incident); after the
  // last: radiance += throughput * (sum of weight * outgoing). Null: not so.
  const float* incident[3] = {};
  float incident_weight[3][4], factor = 0;
  const float* outgoing[3] = {};
  float outgoing_weight[3];

  void start() {
    seen = vec3(0);
    steps.clear();
    incident[0] = outgoing[0] = nullptr;
  }
};

// Eight samples of one pixel on their way through the scene. A lane is at work while it is in `lanes`.
struct Batch {
  Trail trail[batch_size];
  float white[batch_size];  // throughput of a white base
  float gain[batch_size];   // throughput not yet written down: of the roulette
  SurfaceHit hit[batch_size];
  vec3 wo[batch_size];
  int lanes[batch_size], count = 0;

  void start(int lane, const SurfaceHit& met, const vec3& to_eye) {
    trail[lane].start();
    white[lane] = gain[lane] = 1.0f;
    hit[lane] = met;
    wo[lane] = to_eye;
    lanes[count++] = lane;
  }
};

// What one image is traced with.
struct Tracer {
  const Scene& scene;
  const Lights& lights;
  const Accel& accel;
  const PathOptions& options;
  const SurfaceLight* light = nullptr;
};

// Light that a surface holding it throws back at a point: what the vertices throw, between them.
template <int P>
void add_outgoing(Lanes<P>& sum, const Lanes<P>& throughput, const SurfaceLight& light, const Scene& scene, const SurfaceHit& hit) {
  const uvec3 t = scene.instances[hit.instance].surface->triangles[hit.triangle];
  const float weight[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
  const float* at[3];
  for (int k = 0; k < 3; ++k) at[k] = light.outgoing(hit.instance, t[k]);
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < P; ++i) {
      const int j = c * P + i;
      sum.v[c][i] += throughput.v[c][i] * (weight[0] * at[0][j] + weight[1] * at[1][j] + weight[2] * at[2][j]);
    }
}

// Writes down light that a surface holds: what it throws back, and what arrives for its matt base with this shading normal.
inline void note_outgoing(Trail& trail, const SurfaceLight& light, const Scene& scene, const SurfaceHit& hit, float gain) {
  const uvec3 t = scene.instances[hit.instance].surface->triangles[hit.triangle];
  const float weight[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
  for (int k = 0; k < 3; ++k) {
    trail.outgoing[k] = light.outgoing(hit.instance, t[k]);
    trail.outgoing_weight[k] = gain * weight[k];
  }
}
inline void note_incident(Trail& trail, const SurfaceLight& light, const Scene& scene, const SurfaceHit& hit, const vec3& normal, float factor) {
  const Instance& in = scene.instances[hit.instance];
  const uvec3 t = in.surface->triangles[hit.triangle];
  const float weight[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
  for (int k = 0; k < 3; ++k) {
    const Frame frame(glm::normalize(in.posed.normals[t[k]]));
    const float x = glm::dot(normal, frame.x), y = glm::dot(normal, frame.y);
    const float w[4] = {weight[k], weight[k] * x, weight[k] * y, weight[k] * (x * x + y * y)};
    std::copy_n(w, 4, trail.incident_weight[k]);
    trail.incident[k] = light.incident(hit.instance, t[k]);
  }
  trail.factor = factor;
}

// Base colours of the coats first .. first + 7, and their squares. Beyond the last coat the values are any colours.
inline void fetch_eight(const PaintPoint& p, const std::vector<std::shared_ptr<const Texture>>& textures, const float* srgb, int first, __m256* base, __m256* square) {
  if (p.texel[0]) {
    const std::size_t n = p.paint->coats.size();
    const auto color = [&](int corner, int c) {
      const __m128i bytes = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(p.texel[corner] + c * n + first));
      return _mm256_i32gather_ps(srgb, _mm256_cvtepu8_epi32(bytes), 4);
    };
    // What is alike at both ends stays as it is, to the bit.
    const auto between = [](__m256 a, __m256 b, float f) { return _mm256_fmadd_ps(_mm256_set1_ps(f), _mm256_sub_ps(b, a), a); };
    for (int c = 0; c < 3; ++c) {
      __m256 v[4] = {color(0, c)};
      base[c] = v[0];
      square[c] = _mm256_mul_ps(v[0], v[0]);
      if (!p.all_four) continue;
      for (int k = 1; k < 4; ++k) v[k] = color(k, c);
      base[c] = between(between(v[0], v[1], p.fx), between(v[2], v[3], p.fx), p.fy);
      for (__m256& x : v) x = _mm256_mul_ps(x, x);
      square[c] = between(between(v[0], v[1], p.fx), between(v[2], v[3], p.fx), p.fy);
    }
    return;
  }
  alignas(32) float single[3][8], squared[3][8];
  fetch_single_paints(p, textures, first, single, squared);
  for (int c = 0; c < 3; ++c) base[c] = _mm256_load_ps(single[c]), square[c] = _mm256_load_ps(squared[c]);
}

// Radiance of every coat from a path, `padded` coats apart per channel. A coat whose value is not finite gets 0; returns whether any
// did. Every coat goes through the same operations, in whatever batch.
inline bool play(const Trail& trail, const std::vector<std::shared_ptr<const Texture>>& textures, int coats, int padded, float* radiance) {
  const float* srgb = srgb_table().data();
  const __m256 zero = _mm256_setzero_ps();
  bool all_finite = true;
  for (int first = 0; first < coats; first += 8) {
    __m256 sum[3], throughput[3], base[3], square[3];
    for (int c = 0; c < 3; ++c) {
      sum[c] = _mm256_set1_ps(trail.seen[c]);
      throughput[c] = _mm256_set1_ps(1.0f);
    }
    for (const Step& s : trail.steps) {
      fetch_eight(s.paint, textures, srgb, first, base, square);
      for (int c = 0; c < 3; ++c) {
        __m256 f = _mm256_fmadd_ps(base[c], _mm256_set1_ps(s.before[1][c]), _mm256_set1_ps(s.before[0][c]));
        f = _mm256_fmadd_ps(square[c], _mm256_set1_ps(s.before[2][c]), f);
        sum[c] = _mm256_fmadd_ps(throughput[c], f, sum[c]);
      }
      if (trail.incident[0] && &s == trail.steps.data())
        for (int c = 0; c < 3; ++c) {
          __m256 arrives = zero;
          for (int k = 0; k < 3; ++k)
            for (int j = 0; j < 4; ++j)
              arrives = _mm256_fmadd_ps(_mm256_set1_ps(trail.incident_weight[k][j]), _mm256_loadu_ps(trail.incident[k] + (3 * j + c) * padded + first), arrives);
          arrives = _mm256_mul_ps(_mm256_mul_ps(base[c], _mm256_set1_ps(trail.factor)), _mm256_max_ps(arrives, zero));
          sum[c] = _mm256_fmadd_ps(throughput[c], arrives, sum[c]);
        }
      if (!s.goes_on) break;
      for (int c = 0; c < 3; ++c) {
        const __m256 f = _mm256_fmadd_ps(base[c], _mm256_set1_ps(s.next.b), _mm256_set1_ps(s.next.a));
        throughput[c] = _mm256_mul_ps(throughput[c], _mm256_fmadd_ps(square[c], _mm256_set1_ps(s.next.c), f));
        sum[c] = _mm256_fmadd_ps(throughput[c], _mm256_set1_ps(s.after[c]), sum[c]);
      }
    }
    if (trail.outgoing[0])
      for (int c = 0; c < 3; ++c) {
        __m256 thrown = zero;
        for (int k = 0; k < 3; ++k) thrown = _mm256_fmadd_ps(_mm256_set1_ps(trail.outgoing_weight[k]), _mm256_loadu_ps(trail.outgoing[k] + c * padded + first), thrown);
        sum[c] = _mm256_fmadd_ps(throughput[c], thrown, sum[c]);
      }
    // x - x is 0 of finite values alone.
    __m256 finite = _mm256_cmp_ps(_mm256_sub_ps(sum[0], sum[0]), zero, _CMP_EQ_OQ);
    for (int c = 1; c < 3; ++c) finite = _mm256_and_ps(finite, _mm256_cmp_ps(_mm256_sub_ps(sum[c], sum[c]), zero, _CMP_EQ_OQ));
    all_finite = all_finite && _mm256_movemask_ps(finite) == 0xff;
    for (int c = 0; c < 3; ++c) _mm256_storeu_ps(radiance + c * padded + first, _mm256_and_ps(sum[c], finite));
  }
  return !all_finite;
}

// Whether each of `count` shadow rays meets something; the first of them coherent or not.
inline void occluded_rays(const Accel& accel, const Ray* rays, int count, bool coherent, bool* occluded) {
  if (count <= 2) {
    for (int i = 0; i < count; ++i) occluded[i] = accel.occluded(rays[i]);
    return;
  }
  Ray8 packet;
  for (int i = 0; i < batch_size; ++i) packet.set(i, rays[std::min(i, count - 1)], i < count);
  accel.occluded8(packet, coherent);
  for (int i = 0; i < count; ++i) occluded[i] = packet.instance[i] != no_hit;
}

// Traces camera rays that have met the batch's hits; the trails tell their radiance. The estimator per bounce, in solid angle:
//   lights:  Le f cos / p_light * w_light      (next-event estimation)
//   BSDF:    Le f cos / p_bsdf  * w_bsdf       (when the sampled ray meets light)
// with power-heuristic weights. Every decision is as for a white base, so the paths are those of every coat.
//
// The soft part of the sky, all of an even one, is met by BSDF samples alone, and there a guess G of the radiance that arrives, alike in
// all directions, is a control variate: what it would give, albedo(wo) G, is known, and f cos / p G of any BSDF sample, wherever it
// goes, estimates it. The former is added and the latter taken away: the expectation stays, and where the sky is open and even the
// scatter of f cos / p goes. G: the sky around the shading normal times the share of it that the point sees. An estimate may be below 0.
//
// With SurfaceLight, a surface that holds it has its matt base's light looked up, all but that of the lights that are sampled; a
// highlight's ray that meets one ends there.
inline void trace_paths(const Tracer& t, const PixelSampler& sampler, std::uint32_t first, Batch& batch, Counters& counters) {
  ShadingPoint point[batch_size];
  const Environment& environment = *t.lights.environment;
  const SkyShares* sky = environment.is_black() ? nullptr : t.options.sky;
  vec3 guess[batch_size];  // of the radiance that arrives from the sky's soft part
  Frame frame[batch_size];
  Bsdf bsdf[batch_size];
  bool held[batch_size];  // met where the surface holds its light
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
      held[l] = t.light && p.front && t.light->holds(batch.hit[l].instance);
      if (held[l] && bounce > 0) {
        note_outgoing(batch.trail[l], *t.light, t.scene, batch.hit[l], batch.gain[l]);
        continue;
      }
      batch.lanes[alive++] = l;
      const Material& m = *p.material;
      const auto& textures = t.scene.appearance->textures;
      Step& step = batch.trail[l].steps.emplace_back();
      step.paint = find_paint(*t.scene.appearance->paints[m.paint], p.uv, p.vertex_color, texel_u[l], bounce == 0);
      float roughness = m.roughness, metallic = m.metallic;
      if (m.metallic_roughness_texture >= 0) {
        const vec3 texel = texture_rgb(*textures[m.metallic_roughness_texture], p.uv);
        roughness *= texel.y;
        metallic *= texel.z;
      }
      frame[l] = Frame(p.shading);
      // What the camera sees of a dark coat is mostly highlight; after the first bounce most of the light is what light coats throw.
      bsdf[l] = Bsdf(roughness, metallic, frame[l].to_local(batch.wo[l]), m.specular, bounce > 0 ? 0.02f : sky ? 0.35f : 0.15f);
      guess[l] = vec3(0);
      if (p.sky > 0 && bsdf[l].albedo_is_known()) {
        guess[l] = p.sky * environment.soft_around(p.shading);
        BaseResponse albedo = bsdf[l].albedo();
        if (held[l]) albedo = {albedo.a, 0, 0};
        step.light(albedo, batch.gain[l] * guess[l]);
      }
      if (held[l]) note_incident(batch.trail[l], *t.light, t.scene, batch.hit[l], p.shading, bsdf[l].diffuse_factor());
      if (t.lights.count() == 0) continue;
      const LightSample light = t.lights.sample(p.position, choice_u[l].x, light_u[l]);
      if (!(light.pdf > 0) || light.radiance == vec3(0) || !(glm::dot(light.direction, p.geometric) > 0)) continue;
      Bsdf::Value f = bsdf[l].value(frame[l].to_local(light.direction));
      if (!(f.response.white() > 0)) continue;
      rays[count] = {leave(p, light.direction), 0, light.direction, light.distance * (1 - 1e-5f)};
      if (held[l]) {  // the matt base has no other way to this light
        f.response.a *= power_heuristic(light.pdf, held_highlights * f.specular_pdf);
        weight[count] = 1.0f / light.pdf;
      } else {
        weight[count] = power_heuristic(light.pdf, f.pdf) / light.pdf;
      }
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
      batch.trail[l].steps.back().light(response[i], batch.gain[l] * weight[i] * light_radiance[i]);
    }

    float pdf[batch_size];
    count = 0;
    for (int i = 0; i < batch.count; ++i) {
      const int l = batch.lanes[i];
      vec3 wi;
      if (held[l]) {  // only the highlight is left to sample, and it is little
        if (!(lobe_u[l].x < held_highlights)) continue;
        if (!bsdf[l].sample_specular(direction_u[l], wi)) continue;
      } else if (!bsdf[l].sample_direction(direction_u[l], lobe_u[l].x, wi)) {
        continue;
      }
      Bsdf::Value f = bsdf[l].value(wi);
      if (held[l]) {
        f.response = {f.response.a, 0, 0};
        f.pdf = f.response.a > 0 ? held_highlights * f.specular_pdf : 0.0f;
      }
      if (!(f.pdf > 0)) continue;
      const vec3 direction = frame[l].to_world(wi);
      const bool under = glm::dot(direction, point[l].geometric) <= 0;  // the true surface
      Step& step = batch.trail[l].steps.back();
      const float scale = batch.gain[l] / f.pdf;
      step.next = {f.response.a * scale, f.response.b * scale, f.response.c * scale};
      step.goes_on = true;
      batch.gain[l] = 1.0f;
      batch.white[l] *= f.response.white() / f.pdf;
      step.after = -guess[l];
      if (under) continue;
      rays[count] = {leave(point[l], direction), 0, direction, std::numeric_limits<float>::infinity()};
      pdf[count] = f.pdf;
      of[count++] = l;
    }
    SurfaceHit hits[batch_size];
    for (int i = 0; i < count; ++i) hits[i] = t.accel.intersect(rays[i]);
    counters.rays += count;
    alive = 0;
    for (int i = 0; i < count; ++i) {
      const int l = of[i];
      const bool met = hits[i].valid();
      batch.trail[l].steps.back().after +=
          t.lights.seen_by_bsdf_ray(rays[i].origin, rays[i].direction, pdf[i], met ? hits[i].t : std::numeric_limits<float>::infinity());
      if (!met || (t.options.max_bounces > 0 && bounce + 1 >= t.options.max_bounces)) continue;
      if (bounce + 1 >= t.options.roulette_from) {
        const float survive = std::min(survive_at_most, batch.white[l]);
        if (!(lobe_u[l].y < survive)) continue;
        batch.gain[l] = 1.0f / survive;
        batch.white[l] *= batch.gain[l];
      }
      batch.hit[l] = hits[i];
      batch.wo[l] = -rays[i].direction;
      batch.lanes[alive++] = l;
    }
    batch.count = alive;
  }
}

}  // namespace moomill::kernel
