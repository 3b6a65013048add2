// Stress cases of light: lights and whole scenes at the ends of what a scene file may ask for.
#include "generator/core/error.h"
#include "generator/render/bsdf.h"
#include "generator/render/sampler.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

double relative(double value, double truth) {
  return std::abs(value / truth - 1);
}
double or_not_finite(const Shaded& r, double error) {
  return r.not_finite > 0 ? static_cast<double>(r.not_finite) : error;
}

// A square well, 1 m wide and `depth` deep, open at the top at z = 0.
void add_well(Stage& stage, float depth) {
  stage.add(stress_plate({-0.5f, -0.5f, -depth}, {1, 0, 0}, {0, 1, 0}, 4));
  stage.add(stress_plate({-0.5f, -0.5f, -depth}, {0, 1, 0}, {0, 0, depth}, 4));
  stage.add(stress_plate({0.5f, 0.5f, -depth}, {0, -1, 0}, {0, 0, depth}, 4));
  stage.add(stress_plate({0.5f, -0.5f, -depth}, {-1, 0, 0}, {0, 0, depth}, 4));
  stage.add(stress_plate({-0.5f, 0.5f, -depth}, {1, 0, 0}, {0, 0, depth}, 4));
}

double furnace_well(float roughness, float metallic, float depth, int samples = 1024) {
  Stage stage;
  stage.finish(roughness, metallic, vec3(1));
  add_well(stage, depth);
  stage.environment(vec3(1));
  PathOptions o;
  o.samples = samples;
  o.roulette_from = 100;
  o.max_bounces = 100;
  const Shaded r = shade(stage, stress_camera({0, 0, 4}, {0, 0, -4}, 5, 8, 8), o);
  return or_not_finite(r, relative(r.mean.y, 1));
}

// The same with Russian roulette from the third bounce on, which survives with 0.8 at most: no bias, no cap. In a white
// well that sends back more than 0.8 of what enters, as a deep one does, the variance has no bound; so this one is
// shallow.
double furnace_roulette(const StressOptions&) {
  Stage stage;
  stage.finish(1, 0, vec3(1));
  add_well(stage, 0.75f);
  stage.environment(vec3(1));
  PathOptions o;
  o.samples = 4096;
  const Shaded r = shade(stage, stress_camera({0, 0, 4}, {0, 0, -4}, 5, 8, 8), o);
  return or_not_finite(r, relative(r.mean.y, 1));
}

constexpr double plate_cosine = 0.6;  // of the camera's direction on the plate of the next cases
Stage plate_stage(float roughness, float metallic, const vec3& base) {
  Stage stage;
  stage.finish(roughness, metallic, base);
  stage.add(stress_plate({-4, -4, 0}, {8, 0, 0}, {0, 8, 0}, 3));
  return stage;
}
Camera plate_camera() {
  return stress_camera({0.8 * 100, 0, plate_cosine * 100}, {0, 0, 0}, 0.2, 8, 8);
}
const vec3 plate_wo{0.8f, 0, 0.6f};

// What a plate reflects of a sun in one direction: value of the BSDF by the product (its own cases hold it against
// formulas).
double reflected(float roughness, const vec3& base, const vec3& sun) {
  return Bsdf(roughness, 0, plate_wo).evaluate(sun).at(base.y);
}

double sun_over_sky(const StressOptions&) {
  Stage stage = plate_stage(0.9f, 0, vec3(0.5f));
  const vec3 direction = glm::normalize(vec3(-0.3f, 0.5f, 0.7f));
  stage.environment(vec3(1e-3f));
  stage.lights.suns.push_back({direction, vec3(1e6f), 0.00465f});
  PathOptions o;
  o.samples = 64;
  const Shaded r = shade(stage, plate_camera(), o);
  return or_not_finite(r, relative(r.mean.y, 1e6 * reflected(0.9f, vec3(0.5f), direction) + 1e-3 * 0.5));
}

// Where the sun is wholly hidden, the picture must be that without a sun, to the last bit, however bright the sun is.
double hidden_sun(const StressOptions&) {
  Shaded r[2];
  for (int k = 0; k < 2; ++k) {
    Stage stage = plate_stage(0.9f, 0, vec3(0.5f));
    stage.add(stress_plate({-50, -50, 20}, {0, 100, 0}, {100, 0, 0}, 3), -1);  // a roof between plate and sun
    stage.environment(vec3(1e-3f));
    if (k) stage.lights.suns.push_back({vec3(0, 0, 1), vec3(1e6f), 0.00465f});
    PathOptions o;
    o.samples = 256;
    o.max_bounces = 1;  // the roof's upper side is bright: no light that it passes on
    r[k] = shade(stage, stress_camera({8, 0, 6}, {0, 0, 0}, 4, 16, 16), o);
  }
  double differing = static_cast<double>(r[0].not_finite + r[1].not_finite);
  for (std::size_t p = 0; p < r[0].pixels.size(); ++p) differing += r[0].pixels[p] != r[1].pixels[p];
  return r[0].pixels.empty() ? 1 : differing;
}

// A map of 64 x 32 with one pixel of 1e7 in a sky of 1e-3, against the sum over its pixels in double.
double bright_pixel(const StressOptions&) {
  Stage stage = plate_stage(0.8f, 0, vec3(0.5f));
  constexpr int w = 64, h = 32;
  ImageF map(w, h, 3, 1e-3f);
  for (int c = 0; c < 3; ++c) map.at(40, 9, c) = 1e7f;
  stage.lights.environment = std::make_shared<Environment>(map, "map", 1.0f, 0.0);
  PathOptions o;
  o.samples = 1024;
  const Shaded r = shade(stage, plate_camera(), o);
  const Bsdf bsdf(0.8f, 0, plate_wo);
  double truth = 0;
  for (int y = 0; y < h / 2; ++y)
    for (int x = 0; x < w; ++x) {
      double value = 0;
      constexpr int sub = 8;
      for (int a = 0; a < sub; ++a)
        for (int b = 0; b < sub; ++b) {
          const double theta = pi * (y + (a + 0.5) / sub) / h, phi = 2 * pi * ((x + (b + 0.5) / sub) / w - 0.5);
          const vec3 wi(dvec3(-std::sin(theta) * std::sin(phi), -std::sin(theta) * std::cos(phi), std::cos(theta)));
          value += bsdf.evaluate(wi).at(0.5f) * std::sin(theta) / (sub * sub);
        }
      truth += value * map.at(x, y, 1) * (pi / h) * (2 * pi / w);
    }
  return or_not_finite(r, relative(r.mean.y, truth));
}

// The brightest pixel of few samples over the mean, under one bright pixel: nothing but the choice of a place in it
// varies.
double fireflies(const StressOptions&) {
  Stage stage = plate_stage(0.5f, 0, vec3(0.5f));
  ImageF map(64, 32, 3, 1e-3f);
  for (int c = 0; c < 3; ++c) map.at(40, 9, c) = 1e7f;
  stage.lights.environment = std::make_shared<Environment>(map, "map", 1.0f, 0.0);
  Camera camera = plate_camera();
  camera.width = camera.height = 128;
  camera.cx = camera.cy = 64;
  PathOptions o;
  o.samples = 4;
  const Shaded r = shade(stage, camera, o);
  return or_not_finite(r, r.most / r.mean.y);
}

double black(bool map) {
  Stage stage;
  stage.finish(0.3f, 0.5f, vec3(1));
  stage.add(stress_sphere(16, 32, 1, 3));
  if (map) stage.lights.environment = std::make_shared<Environment>(ImageF(8, 4, 3, 0.0f), "black", 1.0f, 0.0);
  PathOptions o;
  o.samples = 16;
  const Shaded r = shade(stage, stress_camera({4, 1, 1}, {0, 0, 0}, 20, 16, 16), o);
  return r.pixels.empty() ? 1 : or_not_finite(r, std::max(std::abs(r.most), std::abs(r.least)));
}

// Light of 1e18 and of 1e-18: the same picture, scaled.
double linear_light(const StressOptions&) {
  const auto render = [](float scale) {
    Stage stage;
    stage.finish(0.4f, 0.3f, vec3(0.8f));
    stage.add(stress_sphere(16, 32, 1, 3));
    stage.environment(vec3(scale));
    stage.lights.suns.push_back({glm::normalize(vec3(1, 1, 2)), vec3(3 * scale), 0.01f});
    RectangleLight rectangle{{3, -1, -1}, {0, 2, 0}, {0, 0, -2}, vec3(2 * scale)};
    stage.lights.rectangles.push_back(rectangle);
    PathOptions o;
    o.samples = 16;
    return shade(stage, stress_camera({4, 1, 1}, {0, 0, 0}, 25, 16, 16), o);
  };
  const Shaded one = render(1);
  double worst = static_cast<double>(one.not_finite);
  for (const float scale : {0x1p60f, 0x1p-60f}) {
    const Shaded other = render(scale);
    worst += static_cast<double>(other.not_finite);
    for (std::size_t p = 0; p < one.pixels.size(); ++p)
      worst = std::max(worst, relative(other.pixels[p].y / double(scale), one.pixels[p].y));
  }
  return worst;
}

// Suns from a point to half the sky: L cos / pdf over their samples is the irradiance, and a plate reflects E f.
double sun_irradiance(const StressOptions&) {
  double worst = 0;
  for (const float radius : {1e-4f, 0.00465f, 0.1f, 0.7f}) {
    Sun sun;
    sun.angular_radius = radius;
    sun.irradiance = vec3(2);
    double sum = 0;
    constexpr int n = 4096;
    for (int i = 0; i < n; ++i) {
      const LightSample s = sun.sample(PixelSampler(1, 2).get(3, i));
      sum += double(s.radiance.y) * s.direction.z / s.pdf / n;
      if (!(sun.pdf(s.direction) > 0) && radius > 1e-3f) ++worst;
    }
    worst = std::max(worst, relative(sum, 2));
  }
  return worst;
}

double point_sun(float radius) {
  Stage stage = plate_stage(0.9f, 0, vec3(0.5f));
  const vec3 direction = glm::normalize(vec3(-0.3f, 0.5f, 0.7f));
  stage.lights.suns.push_back({direction, vec3(2), radius});
  PathOptions o;
  o.samples = 16;
  const Shaded r = shade(stage, plate_camera(), o);
  return or_not_finite(r, relative(r.mean.y, 2 * reflected(0.9f, vec3(0.5f), direction)));
}

// Samples that are not finite, or darker or brighter than the light allows, of rectangles without area, at no distance,
// and of a hundred metres seen from a micrometre.
double odd_rectangles(const StressOptions&) {
  double wrong = 0;
  const RectangleLight odd[] = {{{0, 0, 1}, {0, 0, 0}, {0, 1, 0}, vec3(1)},
                                {{0, 0, 1}, {1, 0, 0}, {1, 0, 0}, vec3(1)},
                                {{0, 0, 1}, {0, 1e-20f, 0}, {1e-20f, 0, 0}, vec3(1)},
                                {{-50, -50, 1e-6f}, {0, 100, 0}, {100, 0, 0}, vec3(1)},
                                {{-0.5f, -0.5f, 0}, {0, 1, 0}, {1, 0, 0}, vec3(1)}};
  for (const RectangleLight& rectangle : odd)
    for (int i = 0; i < 256; ++i) {
      const LightSample s = rectangle.sample(vec3(0), PixelSampler(1, 1).get(0, i));
      wrong += !(std::isfinite(s.pdf) || s.radiance == vec3(0)) || !all_finite(s.radiance);
    }
  for (const RectangleLight& rectangle : odd) {
    Stage stage = plate_stage(1, 0, vec3(1));
    stage.lights.rectangles.push_back(rectangle);
    PathOptions o;
    o.samples = 8;
    const Shaded r = shade(stage, plate_camera(), o);
    wrong += static_cast<double>(r.not_finite) + (r.least < 0) + !(r.most < 1.5);
  }
  return wrong;
}

// A rectangle 1 mm above a white plate is a furnace: the plate shines as the rectangle does.
double near_rectangle(const StressOptions&) {
  Stage stage = plate_stage(1, 0, vec3(1));
  stage.lights.rectangles.push_back({{-2, -2, 1e-3f}, {0, 4, 0}, {4, 0, 0}, vec3(3)});
  PathOptions o;
  o.samples = 1024;
  const Shaded r = shade(stage, plate_camera(), o);
  return or_not_finite(r, relative(r.mean.y, 3));
}

// A sun 0.1 degrees above a plane of 1 km that is tipped so that no coordinate is round: no point may shade itself.
double grazing_sun(const StressOptions&) {
  Stage stage;
  stage.finish(1, 0, vec3(0.5f));
  stage.add(stress_plate({-500, -500, -77.7f}, {1000, 0, 155.4f}, {0, 1000, 0}, 61));
  const vec3 normal = glm::normalize(glm::cross(vec3(1000, 0, 155.4f), vec3(0, 1000, 0)));
  const vec3 along = glm::normalize(vec3(0.3f, 1, 0) - normal * glm::dot(normal, vec3(0.3f, 1, 0)));
  const float angle = static_cast<float>(0.1 * degrees);
  stage.lights.suns.push_back({glm::normalize(std::cos(angle) * along + std::sin(angle) * normal), vec3(1), 1e-4f});
  PathOptions o;
  o.samples = 16;
  o.max_bounces = 1;
  const Shaded r = shade(stage, stress_camera({300, 100, 700}, {0, 0, 0}, 30, 64, 64), o);
  double dark = static_cast<double>(r.not_finite);
  for (const vec3& p : r.pixels) dark += p.y < 0.5 * r.mean.y;
  return r.mean.y > 0 ? dark : 1e9;
}

// Draws from a map of 1024 x 512 whose density, asked for by direction, is another by more than 1e-4.
double density_by_direction(const StressOptions&) {
  ImageF map(1024, 512, 3);
  for (std::size_t i = 0; i < map.data.size(); ++i) map.data[i] = static_cast<float>(std::pow(to_unit(mix64(i / 3)), 8));  // mostly dark: drawn from
  const Environment environment(std::move(map), "map", 1, 0.3);
  double differing = 0;
  constexpr int n = 100'000;
  for (int i = 0; i < n; ++i) {
    const LightSample s = environment.sample(PixelSampler(4, 4).get(0, i));
    differing += relative(environment.pdf(s.direction), s.pdf) > 1e-4;
  }
  return differing / n;
}

double refused_maps(const StressOptions&) {
  double taken = 0;
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  for (const auto& [value, strength] : {std::pair(nan, 1.0f), std::pair(infinity, 1.0f), std::pair(-1e-3f, 1.0f),
                                        std::pair(1e38f, 1e3f), std::pair(1.0f, nan)}) {
    ImageF map(4, 2, 3, 1.0f);
    map.at(2, 1, 1) = value;
    try {
      Environment(map, "sky.hdr", strength, 0);
      ++taken;
    } catch (const InputError& e) {
      taken += std::string(e.what()).rfind("sky.hdr: ", 0) != 0;
    }
  }
  for (const ImageF& map : {ImageF(), ImageF(4, 2, 1, 1.0f)}) try {
      Environment(map, "sky.hdr", 1, 0);
      ++taken;
    } catch (const InputError&) {
    }
  return taken;
}

}  // namespace

std::vector<StressCase> light_stress() {
  constexpr Oracle analytic = Oracle::analytic, precise = Oracle::high_precision, predicate = Oracle::exact_predicate;
  return {
      {"furnace of 100 bounces",
       "a white well twice as deep as wide, white light, no roulette, at most 100 bounces", analytic, 0.01, "",
       "what comes in goes out again; the albedo's tables err by up to 1e-3 a bounce, of which there are about ten, the cap "
       "takes less than 0.2 % (5 % of a well four times as deep), 1,024 x 64 samples scatter by 0.1 %",
       [](const StressOptions&) { return furnace_well(1, 0, 2); }},
      {"furnace of 100 bounces, metal", "a well four times as deep as wide, of white metal with roughness 0.4", analytic, 0.01, "", "as above",
       [](const StressOptions&) { return furnace_well(0.4f, 1, 4); }},
      {"furnace of rough metal", "a well a quarter as deep as wide of white metal with roughness 1", analytic, 0.01, "",
       "as above; not deeper, for many samples of so rough a metal point below its surface and carry nothing, so the "
       "spread grows with every bounce; 16,384 x 64 samples scatter by 0.4 %",
       [](const StressOptions&) { return furnace_well(1, 1, 0.25f, 16384); }},
      {"furnace of 100 bounces, mirror", "the same of white metal with roughness 0", analytic, 0.01, "", "as above",
       [](const StressOptions&) { return furnace_well(0, 1, 4); }},
      {"furnace by roulette", "a white well three quarters as deep as wide, Russian roulette and no cap", analytic,
       0.01, "", "unbiased: 262,144 samples scatter by about 0.3 %, and as above", furnace_roulette},
      {"sun of 1e6 by sky of 1e-3", "a plate under both", analytic, 0.005, "",
       "E f for the sun's centre: its disc of 0.3 degrees changes f by less than 0.5 %", sun_over_sky},
      {"sun of 1e6 behind a roof", "a plate whose sun is hidden, sky of 1e-3", predicate, 0, "pixels",
       "a hidden light adds nothing, so the picture is the same to the last bit", hidden_sun},
      {"map with one bright pixel", "1e7 in a sky of 1e-3, 64 x 32", precise, 0.005, "",
       "65,536 samples drawn within the pixel: its own f varies by a few percent, so the mean scatters by 1e-4; 0.5 % "
       "covers the oracle's 8 x 8 points a pixel",
       bright_pixel},
      {"fireflies", "brightest pixel over mean, 4 samples a pixel, that map", analytic, 2, "times",
       "density is proportional to radiance, so only f varies, within a pixel of 5.6 degrees", fireflies},
      {"black environment", "no light at all", predicate, 0, "radiance", "nothing is reflected: exactly 0 everywhere",
       [](const StressOptions&) { return black(false); }},
      {"black map", "a map whose every pixel is 0", predicate, 0, "radiance",
       "nothing is reflected: exactly 0 everywhere", [](const StressOptions&) { return black(true); }},
      {"light of 2^60 and 2^-60", "sky, sun and rectangle scaled together", analytic, 1e-5, "",
       "radiance is linear in light; powers of two cost no digit, and 1e-5 covers the chances' rounding", linear_light},
      {"suns from 1e-4 to 0.7 radians", "irradiance from 4,096 samples", analytic, 1e-3, "",
       "L cos / density integrates to E; 4,096 low-discrepancy samples err by less than 1e-3", sun_irradiance},
      {"sun without diameter", "angular radius 0, on a plate", analytic, 0.005, "",
       "a sun of no size has its irradiance all the same: E f", [](const StressOptions&) { return point_sun(0); }},
      {"sun of 1e-6 radians", "narrower than float directions resolve", analytic, 0.005, "", "E f",
       [](const StressOptions&) { return point_sun(1e-6f); }},
      {"odd rectangles", "without area, of 1e-20 m, at no distance, 100 m wide 1e-6 m away", predicate, 0, "values",
       "every value is finite, and no more comes back than the light sends", odd_rectangles},
      {"rectangle 1 mm above a white plate", "all a plate sees is light", analytic, 0.01, "",
       "a furnace: the plate is as bright as the light, less 0.1 % at its rim; 0.5 % for the tables, 0.4 % for 65,536 "
       "samples",
       near_rectangle},
      {"sun 0.1 degrees above a plane", "a tipped plane of 1 km with 7,442 faces", predicate, 0, "pixels",
       "a flat surface never shades itself: no pixel is darker than half the mean", grazing_sun},
      {"density of a map by direction", "100,000 draws from a map of 1024 x 512", precise, 2e-3, "of draws",
       "a direction is rounded to 6e-8 of a turn, 1e-4 of a pixel; draws so near a pixel's border are 4e-4 of all",
       density_by_direction},
      {"maps that cannot be used", "not-a-number, infinite, negative, overflowing with its strength, empty, grey",
       predicate, 0, "maps", "each is refused with a sentence that names the file", refused_maps},
  };
}

}  // namespace moomill
