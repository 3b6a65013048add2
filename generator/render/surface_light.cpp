#include "generator/render/surface_light.h"

#include <array>

#include "generator/core/parallel.h"
#include "generator/render/path_kernel.h"

namespace moomill {
namespace {

using namespace kernel;

constexpr std::uint64_t sky_stream = 0x736b79;  // any constant: the vertices' rays are the same in every frame
constexpr int sky_rays = 16;

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

namespace {

constexpr std::uint64_t gather_stream = 0x67617468, paint_stream = 0x7061696e, bounce_stream = 0x626f756e;
constexpr int gather_rays = 256, light_samples = 16, paint_samples = 4, iterations = 6;
constexpr float tilt_sine = 0.342f;  // of 20 degrees
constexpr float pi_f = std::numbers::pi_v<float>;

struct MetSurface {
  SurfaceHit hit;
  int ray;  // of the vertex's
};

bool holds_light(const Scene& scene, const Instance& instance) {
  if (instance.animal < 0) return false;
  for (const int m : instance.materials)
    if (scene.appearance->materials[m].metallic > 0) return false;
  return true;
}

// What a vertex is made of: mean over the faces around it.
template <int P>
struct VertexPaint {
  std::vector<Lanes<P>> base;
  std::vector<float> roughness, specular;
};

template <int P>
VertexPaint<P> paint_of_vertices(const Scene& scene, const Instance& in) {
  const Surface& s = *in.surface;
  const auto& textures = scene.appearance->textures;
  const std::size_t vertices = in.posed.positions.size();
  VertexPaint<P> out{std::vector<Lanes<P>>(vertices), std::vector<float>(vertices, 0.0f), std::vector<float>(vertices, 0.0f)};
  std::vector<float> area(vertices, 0.0f);
  for (auto& b : out.base) b.fill(0.0f);
  for (std::size_t f = 0; f < s.triangles.size(); ++f) {
    const uvec3 t = s.triangles[f];
    const vec3 p0 = in.posed.positions[t[0]];
    const float weight = glm::length(glm::cross(in.posed.positions[t[1]] - p0, in.posed.positions[t[2]] - p0)) / paint_samples;
    const Material& m = scene.material(in, static_cast<std::uint32_t>(f));
    const PixelSampler sampler(paint_stream, f);
    for (int k = 0; k < paint_samples; ++k) {
      const vec2 u = sampler.get(0, k);
      const float root = std::sqrt(u.x);
      const float w[3] = {1 - root, root * (1 - u.y), root * u.y};
      const vec2 uv = s.uvs.empty() ? vec2(0) : w[0] * s.uvs[t[0]] + w[1] * s.uvs[t[1]] + w[2] * s.uvs[t[2]];
      const vec3 color = s.colors.empty() ? vec3(1) : w[0] * s.colors[t[0]] + w[1] * s.colors[t[1]] + w[2] * s.colors[t[2]];
      Lanes<P> base;
      base.fill(0.0f);
      fetch_paint(*scene.appearance->paints[m.paint], textures, uv, color, sampler.get(1, k), P, &base.v[0][0]);
      float roughness = m.roughness;
      if (m.metallic_roughness_texture >= 0) roughness *= texture_rgb(*textures[m.metallic_roughness_texture], uv).y;
      for (int c = 0; c < 3; ++c) {
        const std::uint32_t v = t[c];
        area[v] += weight;
        out.roughness[v] += weight * roughness;
        out.specular[v] += weight * m.specular;
        for (int j = 0; j < 3 * P; ++j) (&out.base[v].v[0][0])[j] += weight * (&base.v[0][0])[j];
      }
    }
  }
  for (std::size_t v = 0; v < vertices; ++v) {
    if (!(area[v] > 0)) continue;
    const float scale = 1.0f / area[v];
    out.roughness[v] *= scale;
    out.specular[v] *= scale;
    for (auto& c : out.base[v].v)
      for (float& x : c) x *= scale;
  }
  return out;
}

// Gathers one instance: what the lights, the sky and surfaces that hold nothing give its vertices, and which surfaces they see.
template <int P>
struct Gathered {
  std::vector<std::array<Lanes<P>, 5>> fixed;  // at the vertex's normal, and at it tilted towards +x, -x, +y, -y
  std::vector<Lanes<P>> direct;                // of the lights that paths sample; at its normal
  std::vector<std::vector<MetSurface>> met;    // of those that hold light
  std::vector<float> scale;                    // of a ray's weight
};

// The weights of a ray in a vertex's frame for the five normals.
void ray_weights(const vec3& d, float roughness, float specular, float* weight) {
  static const float cosine = std::sqrt(1 - tilt_sine * tilt_sine);
  const float c[5] = {d.z, cosine * d.z + tilt_sine * d.x, cosine * d.z - tilt_sine * d.x, cosine * d.z + tilt_sine * d.y, cosine * d.z - tilt_sine * d.y};
  for (int k = 0; k < 5; ++k) weight[k] = c[k] > 0 ? c[k] * (1 - specular * specular_albedo(c[k], roughness)) : 0.0f;
}
vec3 uniform_hemisphere(const vec2& u) {
  const float r = std::sqrt(std::max(0.0f, 1 - u.x * u.x)), phi = 2 * pi_f * u.y;
  return {r * std::cos(phi), r * std::sin(phi), u.x};
}

template <int P>
Gathered<P> gather_instance(const Tracer& t, const std::vector<bool>& holds, std::size_t instance, const VertexPaint<P>& paint) {
  const Instance& in = t.scene.instances[instance];
  const std::size_t vertices = in.posed.positions.size();
  Gathered<P> out;
  out.fixed.resize(vertices);
  out.direct.resize(vertices);
  out.met.resize(vertices);
  out.scale.assign(vertices, 0.0f);
  parallel_for(vertices, 64, [&](std::size_t v) {
    for (auto& f : out.fixed[v]) f.fill(0.0f);
    out.direct[v].fill(0.0f);
    const float length = glm::length(in.posed.normals[v]);
    if (!(length > 1e-6f)) return;
    const Frame frame(in.posed.normals[v] / length);
    const vec3 from = off_surface(in.posed.positions[v], frame.z);
    const float roughness = paint.roughness[v], specular = paint.specular[v];
    const PixelSampler sampler(gather_stream, (static_cast<std::uint64_t>(instance) << 40) + v);
    const PixelSampler bounce_sampler(bounce_stream, (static_cast<std::uint64_t>(instance) << 40) + v);
    float total = 0;
    Batch batch;
    Lanes<P> radiance;
    radiance.fill(0.0f);
    Counters counters;
    vec3 sky[5] = {};
    for (int first = 0; first < gather_rays; first += 8) {
      vec2 u[8];
      sampler.get8(0, first, u);
      Ray8 rays;
      vec3 local[8];
      float weight[8][5];
      for (int i = 0; i < 8; ++i) {
        local[i] = uniform_hemisphere(u[i]);
        rays.set(i, {from, 0, frame.to_world(local[i]), std::numeric_limits<float>::infinity()}, true);
      }
      t.accel.intersect8(rays, false);
      batch.count = 0;
      int traced[8], traced_count = 0;
      for (int i = 0; i < 8; ++i) {
        ray_weights(local[i], roughness, specular, weight[i]);
        total += weight[i][0];
        if (rays.instance[i] == no_hit) {
          const vec3 soft = t.lights.environment->soft_radiance(frame.to_world(local[i]));
          for (int k = 0; k < 5; ++k) sky[k] += weight[i][k] * soft;
          continue;
        }
        const SurfaceHit hit{rays.instance[i], rays.triangle[i], rays.u[i], rays.v[i], rays.far[i]};
        if (holds[hit.instance] && met_in_front(t.scene, hit, -frame.to_world(local[i]))) {
          out.met[v].push_back({hit, first + i});
          continue;
        }
        batch.start(i, hit, -frame.to_world(local[i]));
        traced[traced_count++] = i;
      }
      if (batch.count == 0) continue;
      trace_paths(t, bounce_sampler, first, batch, counters);
      for (int j = 0; j < traced_count; ++j) {
        play(batch.trail[traced[j]], t.scene.appearance->textures, t.scene.appearance->coat_count, P, &radiance.v[0][0]);
        for (int k = 0; k < 5; ++k)
          for (int e = 0; e < 3 * P; ++e) (&out.fixed[v][k].v[0][0])[e] += weight[traced[j]][k] * (&radiance.v[0][0])[e];
      }
    }
    // So that an open sky has exactly its integral.
    const float scale = total > 0 ? pi_f * (1 - specular * mean_specular_albedo(roughness)) / total : 0.0f;
    out.scale[v] = scale;
    for (int k = 0; k < 5; ++k)
      for (int c = 0; c < 3; ++c)
        for (int i = 0; i < P; ++i) out.fixed[v][k].v[c][i] = scale * (out.fixed[v][k].v[c][i] + sky[k][c]);

    vec3 direct(0);
    for (int s = 0; s < light_samples && t.lights.count() > 0; ++s) {
      const LightSample l = t.lights.sample(in.posed.positions[v], sampler.get(1, s).x, sampler.get(2, s));
      const float cosine = glm::dot(l.direction, frame.z);
      if (!(l.pdf > 0) || l.radiance == vec3(0) || !(cosine > 0)) continue;
      if (t.accel.occluded({from, 0, l.direction, l.distance * (1 - 1e-5f)})) continue;
      direct += l.radiance * (cosine * (1 - specular * specular_albedo(cosine, roughness)) / (l.pdf * light_samples));
    }
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < P; ++i) out.direct[v].v[c][i] = direct[c];
  });
  return out;
}

template <int P>
void gather_all(const Scene& scene, const Lights& lights, const Accel& accel, SurfaceLight& light) {
  const std::size_t n = scene.instances.size();
  std::vector<bool> holds(n);
  for (std::size_t i = 0; i < n; ++i) holds[i] = holds_light(scene, scene.instances[i]);
  PathOptions options;
  const Tracer tracer{scene, lights, accel, options};
  std::vector<VertexPaint<P>> paint(n);
  std::vector<Gathered<P>> gathered(n);
  for (std::size_t i = 0; i < n; ++i) {
    if (!holds[i]) continue;
    paint[i] = paint_of_vertices<P>(scene, scene.instances[i]);
    gathered[i] = gather_instance<P>(tracer, holds, i, paint[i]);
    const std::size_t vertices = scene.instances[i].posed.positions.size();
    light.instances[i].incident.assign(vertices * 12 * P, 0.0f);
    light.instances[i].outgoing.assign(vertices * 3 * P, 0.0f);
  }
  // Jacobi iteration: each round throws on what the one before has thrown. Albedo times the share that surfaces see of each other,
  // well below a half on animals, to the power of the rounds is what stays behind.
  for (int round = 0; round <= iterations; ++round) {
    std::vector<std::vector<float>> thrown(n);
    for (std::size_t i = 0; i < n; ++i) {
      if (!holds[i]) continue;
      const Gathered<P>& g = gathered[i];
      thrown[i].resize(light.instances[i].outgoing.size());
      parallel_for(g.met.size(), 64, [&](std::size_t v) {
        const bool last = round == iterations;
        const int normals = last ? 5 : 1;
        std::array<Lanes<P>, 5> sum = g.fixed[v];
        const PixelSampler sampler(gather_stream, (static_cast<std::uint64_t>(i) << 40) + v);
        const float roughness = paint[i].roughness[v], specular = paint[i].specular[v];
        Lanes<P> one;
        one.fill(1.0f);
        if (round > 0)
          for (const MetSurface& m : g.met[v]) {
            Lanes<P> radiance;
            radiance.fill(0.0f);
            add_outgoing(radiance, one, light, scene, m.hit);
            float weight[5];
            ray_weights(uniform_hemisphere(sampler.get(0, m.ray)), roughness, specular, weight);
            for (int k = 0; k < normals; ++k)
              for (int e = 0; e < 3 * P; ++e) (&sum[k].v[0][0])[e] += weight[k] * g.scale[v] * (&radiance.v[0][0])[e];
          }
        // The specular lobe throws its share on as if it were matt: E = I / (1 - mean Ed).
        const float reflected = specular * mean_specular_albedo(roughness), passed = 1 - reflected;
        for (int e = 0; e < 3 * P; ++e) {
          const float base = (&paint[i].base[v].v[0][0])[e], all = (&sum[0].v[0][0])[e] + (&g.direct[v].v[0][0])[e];
          thrown[i][3 * P * v + e] = (base * passed + reflected) * all / (passed * pi_f);
        }
        if (!last) return;
        float* c = &light.instances[i].incident[12 * P * v];
        constexpr float s = tilt_sine;
        for (int e = 0; e < 3 * P; ++e) {
          float at[5];
          for (int k = 0; k < 5; ++k) at[k] = (&sum[k].v[0][0])[e];
          c[e] = at[0];
          c[3 * P + e] = (at[1] - at[2]) / (2 * s);
          c[6 * P + e] = (at[3] - at[4]) / (2 * s);
          c[9 * P + e] = (at[1] + at[2] + at[3] + at[4] - 4 * at[0]) / (4 * s * s);
        }
      });
    }
    for (std::size_t i = 0; i < n; ++i)
      if (holds[i]) light.instances[i].outgoing = std::move(thrown[i]);
  }
}

}  // namespace

SurfaceLight gather_light(const Scene& scene, const Lights& lights, const Accel& accel) {
  SurfaceLight light;
  light.padded = padded_coats(scene.appearance->coat_count);
  light.instances.resize(scene.instances.size());
  with_padded_coats(scene.appearance->coat_count, [&]<int P>() { gather_all<P>(scene, lights, accel, light); });
  return light;
}

}  // namespace moomill
