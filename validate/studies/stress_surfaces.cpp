// Stress cases of surfaces under light: roughness, albedo and normal maps at the ends of what a material may hold.
#include "generator/render/bsdf.h"
#include "generator/render/sampler.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

vec3 towards(float cosine) {
  return {std::sqrt(1 - cosine * cosine), 0, cosine};
}

// Departure from 1 of what a white surface reflects of white light, over angles and metalness.
double white_furnace(float roughness) {
  double worst = 0;
  for (const float metallic : {0.0f, 0.5f, 1.0f})
    for (const float cosine : {0.02f, 0.1f, 0.3f, 0.7f, 1.0f}) {
      const Bsdf bsdf(roughness, metallic, towards(cosine));
      double sum = 0;
      constexpr int n = 1 << 15;
      const PixelSampler sampler(9, 1);
      for (int i = 0; i < n; ++i) {
        const BsdfSample s = bsdf.sample(sampler.get(0, i), sampler.get(1, i).x);
        if (s.pdf > 0) sum += double(bsdf.evaluate(s.wi).white()) / s.pdf / n;
      }
      worst = std::max(worst, std::abs(sum - 1));
    }
  return worst;
}

// Fresnel's equations and the GGX lobe as their formulas stand, in double.
double fresnel(double c) {
  const double t = std::sqrt(1 - (1 - c * c) / (1.5 * 1.5));
  const double s = (c - 1.5 * t) / (c + 1.5 * t), p = (1.5 * c - t) / (1.5 * c + t);
  return 0.5 * (s * s + p * p);
}
double lobe(const dvec3& wo, const dvec3& wi, double alpha) {
  const dvec3 h = glm::normalize(wo + wi);
  const double a2 = alpha * alpha, q = h.x * h.x + h.y * h.y + a2 * h.z * h.z;
  const auto lambda = [&](const dvec3& w) {
    return 0.5 * (std::sqrt(1 + a2 * (w.x * w.x + w.y * w.y) / (w.z * w.z)) - 1);
  };
  return a2 / (pi * q * q) / (1 + lambda(wo) + lambda(wi)) * fresnel(glm::dot(wo, h)) / (4 * wo.z);
}

// Values of the specular lobe for directions drawn from it, against those formulas with the very same directions.
double narrow_lobe(float roughness) {
  double worst = 0;
  const double alpha = std::max(double(roughness) * roughness, double(bsdf_min_alpha));
  for (const float cosine : {0.02f, 0.1f, 0.5f, 0.9f, 1.0f}) {
    const vec3 wo = towards(cosine);
    const Bsdf bsdf(roughness, 0, wo);
    for (int i = 0; i < 2000; ++i) {
      const BsdfSample s = bsdf.sample(PixelSampler(3, 3).get(0, i), 0.0f);
      if (!(s.pdf > 0)) continue;
      worst = std::max(worst, std::abs(bsdf.evaluate(s.wi).a / lobe(dvec3(wo), dvec3(s.wi), alpha) - 1));
    }
  }
  return worst;
}

// A smooth black dielectric reflects as Fresnel's equations say.
double smooth_black(const StressOptions&) {
  double worst = 0;
  for (const float cosine : {0.1f, 0.3f, 0.7f, 1.0f}) {
    const Bsdf bsdf(0, 0, towards(cosine));
    double sum = 0;
    constexpr int n = 1 << 14;
    for (int i = 0; i < n; ++i) {
      const BsdfSample s = bsdf.sample(PixelSampler(9, 2).get(0, i), PixelSampler(9, 2).get(1, i).x);
      if (s.pdf > 0) sum += double(bsdf.evaluate(s.wi).at(0)) / s.pdf / n;
    }
    worst = std::max(worst, std::abs(sum / fresnel(cosine) - 1));
  }
  return worst;
}

// A black rough plate in white light, through the path tracer, against a double integral over the hemisphere.
double rough_black(const StressOptions&) {
  Stage stage;
  stage.finish(0.5f, 0, vec3(0));
  stage.add(stress_plate({-4, -4, 0}, {8, 0, 0}, {0, 8, 0}, 3));
  stage.environment(vec3(1));
  PathOptions o;
  o.samples = 1024;
  const Shaded r = shade(stage, stress_camera({80, 0, 60}, {0, 0, 0}, 0.2, 8, 8), o);
  double truth = 0;
  constexpr int n = 600;
  for (int a = 0; a < n; ++a)
    for (int b = 0; b < n; ++b) {
      const double z = (a + 0.5) / n, phi = pi * (b + 0.5) / n, s = std::sqrt(1 - z * z);
      truth += lobe({0.8, 0, 0.6}, {s * std::cos(phi), s * std::sin(phi), z}, 0.25) * 2 * pi / (n * n);
    }
  return r.not_finite > 0 ? static_cast<double>(r.not_finite) : std::abs(r.mean.y / truth - 1);
}

// Largest weight of a sample, in multiples of what its lobe may carry at most.
double largest_weight(const StressOptions&) {
  double worst = 0;
  for (const float roughness : {0.0f, 1e-4f, 0.05f, 0.2f, 0.5f, 1.0f})
    for (const float metallic : {0.0f, 0.5f, 1.0f})
      for (const float cosine : {1e-4f, 0.02f, 0.1f, 0.4f, 1.0f}) {
        const Bsdf bsdf(roughness, metallic, towards(cosine));
        for (int i = 0; i < 4096; ++i) {
          const BsdfSample s = bsdf.sample(PixelSampler(5, 5).get(0, i), PixelSampler(5, 5).get(1, i).x);
          if (s.pdf > 0) worst = std::max(worst, double(bsdf.evaluate(s.wi).white()) / s.pdf);
        }
      }
  return worst;
}

// Random pairs of directions, most of them grazing: values that are not finite or negative.
double grazing_directions(const StressOptions&) {
  double wrong = 0;
  for (int i = 0; i < 200'000; ++i) {
    const vec2 a = PixelSampler(6, 6).get(0, i), b = PixelSampler(6, 6).get(1, i), c = PixelSampler(6, 6).get(2, i);
    const float zo = std::pow(10.0f, -38 * a.x), zi = std::pow(10.0f, -38 * a.y),
                phi = 2 * static_cast<float>(pi) * b.x;
    const vec3 wo(std::sqrt(1 - zo * zo), 0, zo),
        wi(std::sqrt(1 - zi * zi) * std::cos(phi), std::sqrt(1 - zi * zi) * std::sin(phi), zi);
    const float roughness = c.x < 0.2f ? 0.0f : c.x < 0.4f ? 1e-4f : c.x;
    const Bsdf bsdf(roughness, i % 3 * 0.5f, wo);
    const BaseResponse f = bsdf.evaluate(wi);
    const float pdf = bsdf.pdf(wi);
    wrong +=
        !std::isfinite(f.white()) || !(f.a >= 0) || !(f.b >= 0) || !(f.c >= 0) || !std::isfinite(pdf) || !(pdf >= 0);
  }
  return wrong;
}

// Balancing heuristics at both ends of floats: values outside [0, 1].
double heuristic(const StressOptions&) {
  const float most = std::numeric_limits<float>::max(), least = std::numeric_limits<float>::min(),
              infinity = std::numeric_limits<float>::infinity();
  double wrong = 0;
  for (const float a : {0.0f, least, 1e-20f, 1.0f, 1e20f, most})
    for (const float b : {0.0f, least, 1e-20f, 1.0f, 1e20f, most, infinity}) {
      const float w = power_heuristic(a, b);
      wrong += !(w >= 0 && w <= 1);
      if (a > 0 && a == b) wrong += w != 0.5f;
    }
  return wrong;
}

// A white plate whose normal map is this colour everywhere, in white light: more than it may reflect, or not finite.
double normal_map(const std::array<std::uint8_t, 3>& texel, float scale, float roughness, float metallic) {
  Stage stage;
  const int finish = stage.finish(roughness, metallic, vec3(1));
  Image8 image(4, 4, 3);
  for (std::size_t i = 0; i < image.data.size(); ++i) image.data[i] = texel[i % 3];
  const int texture = stage.texture(image);
  stage.material(finish).normal_texture = texture;
  stage.material(finish).normal_scale = scale;
  stage.add(stress_plate({-4, -4, 0}, {8, 0, 0}, {0, 8, 0}, 3));
  stage.environment(vec3(1));
  stage.lights.suns.push_back({glm::normalize(vec3(1, 0, 0.01f)), vec3(1e-3f), 0.00465f});
  PathOptions o;
  o.samples = 512;
  const Shaded r = shade(stage, stress_camera({80, 0, 60}, {0, 0, 0}, 0.2, 8, 8), o);
  if (r.not_finite > 0 || r.pixels.empty() || r.least < 0) return 1e9;
  return std::max(0.0, r.mean.y - 1);
}

double normal_maps(float roughness, float metallic) {
  double worst = 0;
  for (const float scale : {1.0f, 1000.0f, -1.0f})
    for (const std::array<std::uint8_t, 3>& texel : {std::array<std::uint8_t, 3>{255, 128, 128},
                                                     {0, 128, 128},
                                                     {128, 255, 130},
                                                     {128, 128, 0},
                                                     {0, 0, 0},
                                                     {255, 255, 255},
                                                     {128, 128, 128}})
      worst = std::max(worst, normal_map(texel, scale, roughness, metallic));
  return worst;
}

// A ball with smooth normals of few faces, seen and lit at grazing angles: samples that are not finite, negative
// radiance, or more than a furnace gives.
double coarse_ball(const StressOptions&) {
  Surface ball = stress_sphere(6, 8, 1);
  for (std::size_t v = 0; v < ball.rest.size(); ++v) ball.normals[v] = glm::normalize(ball.rest[v]);
  Stage stage;
  stage.finish(0.2f, 1, vec3(1));
  stage.add(std::move(ball));
  stage.environment(vec3(1));
  PathOptions o;
  o.samples = 256;
  const Shaded r = shade(stage, stress_camera({5, 1, 0.3}, {0, 0, 0}, 26, 32, 32), o);
  if (r.not_finite > 0 || r.least < 0) return 1e9;
  return std::max(0.0, r.most - 1);
}

// Normals of length zero, opposite at the ends of an edge, and not finite UVs: samples that are not finite.
double broken_normals(const StressOptions&) {
  Surface ball = stress_sphere(12, 24, 1);
  ball.uvs.assign(ball.rest.size(), vec2(0.5f));
  for (std::size_t v = 0; v < ball.rest.size(); ++v) {
    if (v % 3 == 0) ball.normals[v] = vec3(0);
    if (v % 3 == 1) ball.normals[v] = -ball.normals[v];
    if (v % 5 == 0) ball.uvs[v] = vec2(1e30f);
  }
  Stage stage;
  const int finish = stage.finish(0.1f, 0.5f, vec3(0.9f));
  Image8 image(4, 4, 3, 200);
  const int texture = stage.texture(image);
  stage.material(finish).normal_texture = texture;
  stage.material(finish).metallic_roughness_texture = texture;
  stage.add(std::move(ball));
  stage.environment(vec3(1));
  stage.lights.suns.push_back({glm::normalize(vec3(1, 0, 0.2f)), vec3(10), 0.00465f});
  PathOptions o;
  o.samples = 64;
  const Shaded r = shade(stage, stress_camera({5, 1, 0.3}, {0, 0, 0}, 26, 32, 32), o);
  return static_cast<double>(r.not_finite) + (r.pixels.empty() || !std::isfinite(r.most) || r.least < 0);
}

}  // namespace

std::vector<StressCase> surface_light_stress() {
  constexpr Oracle analytic = Oracle::analytic, precise = Oracle::high_precision, predicate = Oracle::exact_predicate;
  const char* const tables = "the albedo's tables have 64 x 65 entries and hold to 0.5 %";
  return {
      {"white furnace at roughness 0", "a white BSDF, 5 angles down to 1 degree, 3 metalnesses", analytic, 0.005, "",
       tables, [](const StressOptions&) { return white_furnace(0); }},
      {"white furnace at roughness 1e-4", "the same", analytic, 0.005, "", tables,
       [](const StressOptions&) { return white_furnace(1e-4f); }},
      {"white furnace at roughness 1", "the same", analytic, 0.005, "", tables,
       [](const StressOptions&) { return white_furnace(1); }},
      {"lobe at roughness 0", "values for drawn directions against the formulas in double", precise, 2e-3, "",
       "the half vector's sine is 1e-3 and each component has an error of 1e-7: 1e-4 of the sine, four times that in "
       "D, more in the lobe's tail",
       [](const StressOptions&) { return narrow_lobe(0); }},
      {"lobe at roughness 0.1", "the same", precise, 2e-4, "", "as above with a sine of 1e-2",
       [](const StressOptions&) { return narrow_lobe(0.1f); }},
      {"albedo 0, smooth", "a black smooth dielectric, 4 angles", analytic, 0.005, "",
       "what is left is Fresnel's reflectance; a lobe of 1e-3 is a mirror to 0.1 %", smooth_black},
      {"albedo 0, rough", "a black plate of roughness 0.5 in white light", precise, 0.005, "",
       "65,536 samples scatter by 0.2 %; the double integral has 360,000 points", rough_black},
      {"largest weight of a sample", "6 roughnesses, 3 metalnesses, 5 angles down to 1e-4, 4,096 samples each",
       analytic, 1 / 0.15, "times",
       "either lobe is chosen with at least 0.15 and 0.05, in proportion to what it carries; value over density of a "
       "lobe by itself is at most 1",
       largest_weight},
      {"grazing directions", "200,000 pairs with cosines down to 1e-38", predicate, 0, "pairs",
       "values and densities are finite and not negative", grazing_directions},
      {"weights of two densities", "densities from 1e-38 to 3e38 and infinite", predicate, 0, "pairs",
       "weights lie in [0, 1] and are 1/2 for equals", heuristic},
      {"grazing normal maps, rough",
       "normals in the surface, below it, of length 0, scaled by 1000 and by -1, in white light", analytic, 0.01, "",
       "a furnace: bent normals may lose light, never make it; 0.5 % for the tables, 0.5 % for the samples",
       [](const StressOptions&) { return normal_maps(1, 0); }},
      {"grazing normal maps, metal", "the same on metal of roughness 0.2", analytic, 0.01, "", "as above",
       [](const StressOptions&) { return normal_maps(0.2f, 1); }},
      {"coarse ball with smooth normals", "48 faces of metal, in white light: brightest pixel", analytic, 0.02, "",
       "leaning normals may lose light, never make it; a pixel of 256 samples scatters by 1 %", coarse_ball},
      {"broken normals and UVs", "normals of length 0 and turned inside out, UVs of 1e30", predicate, 0, "samples",
       "every sample is finite and not negative", broken_normals},
  };
}

}  // namespace moomill
