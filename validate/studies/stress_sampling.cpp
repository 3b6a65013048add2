// Stress cases of sampling: the first, the millionth and the last sample, the last dimension, and random numbers at
// both ends.
#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "generator/render/bsdf.h"
#include "generator/render/path.h"
#include "generator/render/sampler.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

constexpr float below_one = 0x1.fffffep-1f;  // the largest float below 1

bool in_unit(const vec2& u) {
  return u.x >= 0 && u.x < 1 && u.y >= 0 && u.y < 1;
}
bool is_unit(const vec3& d, double slack = 1e-5) {
  return std::abs(glm::length(dvec3(d)) - 1) <= slack;
}

// The first sample of every pixel of a 1024 x 768 picture, in cells of 1/16 by 1/16 and against each other: the largest
// departure of chi-squared from its mean, in standard deviations.
double first_samples(const StressOptions&) {
  constexpr int cells = 16, pixels = 1024 * 768;
  double worst = 0;
  for (const std::uint32_t pair : {0u, 1u, 501u}) {
    std::vector<double> count(cells * cells, 0.0);
    for (int p = 0; p < pixels; ++p) {
      const vec2 u = PixelSampler(77, p).get(pair, 0);
      if (!in_unit(u)) return std::numeric_limits<double>::infinity();
      ++count[static_cast<int>(u.x * cells) * cells + static_cast<int>(u.y * cells)];
    }
    double chi = 0;
    const double expected = static_cast<double>(pixels) / (cells * cells), freedom = cells * cells - 1;
    for (const double c : count) chi += (c - expected) * (c - expected) / expected;
    worst = std::max(worst, std::abs(chi - freedom) / std::sqrt(2 * freedom));
  }
  return worst;
}

// 2^20 samples of a pixel: every interval of 2^-20 of either axis, and every cell of 2^-10 by 2^-10, must hold exactly
// one.
double million_samples(const StressOptions&) {
  constexpr int n = 1 << 20;
  double wrong = 0;
  const PixelSampler sampler(1, 12345);
  std::vector<std::uint8_t> x(n, 0), y(n, 0), cell(n, 0);
  for (int i = 0; i < n; ++i) {
    const vec2 u = sampler.get(0, i);
    if (!in_unit(u)) return n;
    ++x[static_cast<int>(u.x * n)];
    ++y[static_cast<int>(u.y * n)];
    ++cell[static_cast<int>(u.x * 1024) * 1024 + static_cast<int>(u.y * 1024)];
  }
  for (int i = 0; i < n; ++i) wrong += (x[i] != 1) + (y[i] != 1) + (cell[i] != 1);
  return wrong;
}

// Samples and dimensions at the end of 32 bits: in range, and blocks of 64 samples still nets.
double last_indices(const StressOptions&) {
  double wrong = 0;
  for (const std::uint32_t pair : {0u, 505u, 5'000'004u, 0xffffffffu})
    for (const std::uint32_t first : {0u, 1'000'000u / 64 * 64, 0xffffffc0u})
      for (const std::uint64_t pixel : {0ull, 786'431ull, ~0ull}) {
        const PixelSampler sampler(~0ull, pixel);
        for (int a = 0; a <= 6; ++a) {
          std::vector<int> count(64, 0);
          for (std::uint32_t i = 0; i < 64; ++i) {
            const vec2 u = sampler.get(pair, first + i);
            if (!in_unit(u)) return 64;
            ++count[(static_cast<int>(u.x * (1 << a)) << (6 - a)) + static_cast<int>(u.y * (1 << (6 - a)))];
          }
          for (const int c : count) wrong += c != 1;
        }
      }
  return wrong;
}

// Correlation of the dimensions of bounce 100 with those of the first bounce, over pixels, in standard deviations.
double far_dimensions(const StressOptions&) {
  constexpr int n = 200'000;
  double worst = 0;
  for (const std::uint32_t pair : {1u, 2u, 501u, 505u}) {
    double sum = 0;
    for (int p = 0; p < n; ++p) {
      const PixelSampler s(3, p);
      sum += (s.get(pair, 5).x - 0.5) * (s.get(pair == 501 ? 1 : 501, 5).x - 0.5);
    }
    if (pair != 501) worst = std::max(worst, std::abs(sum) / std::sqrt(n / 144.0));
  }
  return worst;
}

// Everything that is drawn from two numbers, at both ends of both: values that are not finite, not unit, or without
// density.
double corners(const std::function<bool(const vec2&, float)>& sound) {
  double wrong = 0;
  for (const float x : {0.0f, 0x1p-24f, 0.5f, below_one})
    for (const float y : {0.0f, 0x1p-24f, 0.25f, 0.5f, below_one})
      for (const float z : {0.0f, below_one}) wrong += !sound({x, y}, z);
  return wrong;
}

double corners_of_bsdf(const StressOptions&) {
  return corners([](const vec2& u, float lobe) {
    bool sound = is_unit(sample_cosine_hemisphere(u)) && sample_cosine_hemisphere(u).z > 0;
    for (const float cosine : {1e-30f, 1e-8f, 1e-4f, 0.02f, 0.5f, 1.0f})
      for (const float roughness : {0.0f, 1e-4f, 0.03f, 0.5f, 1.0f}) {
        const vec3 wo(std::sqrt(1 - cosine * cosine), 0, cosine);
        const vec3 h = sample_ggx_visible_normal(wo, std::max(roughness * roughness, bsdf_min_alpha), u);
        sound = sound && is_unit(h) && h.z > 0;
        for (const float metallic : {0.0f, 0.5f, 1.0f}) {
          const Bsdf bsdf(roughness, metallic, wo);
          const BsdfSample s = bsdf.sample(u, lobe);
          if (!(s.pdf > 0)) {
            sound = sound && s.pdf == 0;
            continue;
          }
          const BaseResponse f = bsdf.evaluate(s.wi);
          sound = sound && is_unit(s.wi) && std::isfinite(s.pdf) && std::isfinite(f.white()) && f.a >= 0 && f.b >= 0 &&
                  f.white() / s.pdf < 1e3f;
        }
      }
    return sound;
  });
}

double corners_of_lights(const StressOptions&) {
  ImageF map(16, 8, 3, 0.0f);  // black but for a few, which all draws must find; at the ends of rows and inside
  for (int c = 0; c < 3; ++c)
    for (const auto& [x, y] : {std::pair(0, 1), std::pair(15, 2), std::pair(5, 4), std::pair(6, 4), std::pair(9, 6)}) map.at(x, y, c) = 0.2f;
  const Environment environment(map, "map", 1, 0.7), pixel(ImageF(1, 1, 3, 1.0f), "pixel", 1, 0);
  RectangleLight rectangle;
  rectangle.corner = {-1, -1, -2};
  Lights all;
  all.environment = std::make_shared<Environment>(map, "map", 1.0f, 0.7);
  all.suns.push_back({});
  all.rectangles.push_back(rectangle);
  all.prepare(vec3(0));
  return corners([&](const vec2& u, float xi) {
    const auto drawn = [](const LightSample& s, bool may_fail) {
      return std::isfinite(s.pdf) && is_unit(s.direction) && all_finite(s.radiance) &&
             (may_fail ? s.pdf >= 0 : s.pdf > 0);
    };
    Sun wide, narrow;
    wide.angular_radius = 1.5f;
    narrow.angular_radius = 1e-4f;
    return drawn(environment.sample(u), false) && luminance(environment.sample(u).radiance) > 0 &&
           drawn(pixel.sample(u), false) && drawn(wide.sample(u), false) && drawn(narrow.sample(u), false) &&
           drawn(rectangle.sample(vec3(0), u), true) && drawn(all.sample(vec3(0), xi, u), true);
  });
}

double corners_of_filter_and_texture(const StressOptions&) {
  const PixelFilter filter(1.5);
  TexturePlacement repeat, mirror, clamp;
  mirror.wrap_u = mirror.wrap_v = Wrap::mirror;
  clamp.wrap_u = clamp.wrap_v = Wrap::clamp;
  return corners([&](const vec2& u, float) {
    bool sound =
        std::abs(filter.sample(u.x)) <= 1.5f && filter.sample(u.x) <= filter.sample(std::min(below_one, u.x + 0.01f));
    for (const TexturePlacement& p : {repeat, mirror, clamp})
      for (const vec2& uv :
           {vec2(0), vec2(1), vec2(-1e-9f), vec2(1e30f), vec2(-1e30f), vec2(std::numeric_limits<float>::infinity()),
            vec2(std::numeric_limits<float>::quiet_NaN()), vec2(0.5f, 3e7f)}) {
        const glm::ivec2 t = choose_texel(p, 7, 5, uv, u);
        sound = sound && t.x >= 0 && t.x < 7 && t.y >= 0 && t.y < 5;
      }
    return sound;
  });
}

double ends_of_numbers(const StressOptions&) {
  double wrong = 0;
  for (const std::uint64_t bits :
       {std::uint64_t{0}, std::uint64_t{1}, ~std::uint64_t{0}, ~std::uint64_t{0} << 11, std::uint64_t{1} << 63})
    wrong += !(to_unit(bits) >= 0 && to_unit(bits) < 1) || !std::isfinite(to_normal(bits));
  for (const std::uint32_t bits : {0u, 255u, 0xffffffffu, 0xffffff00u})
    wrong += !(unit_float(bits) >= 0 && unit_float(bits) < 1);
  wrong += to_unit(~std::uint64_t{0}) != 1 - 0x1p-53 || unit_float(0xffffffffu) != below_one;
  return wrong;
}

double portable_functions(const StressOptions&) {
  double worst = 0;
  for (int i = -3000; i <= 3000; ++i) {
    const double x = std::pow(10.0, i / 10.0);
    const long double truth = std::log(static_cast<long double>(x));
    // Near 1 the logarithm vanishes: relative to the larger of it and x - 1's own rounding.
    worst = std::max(
        worst, static_cast<double>(std::abs(portable_log(x) - truth) / std::max<long double>(std::abs(truth), 1e-3L)));
    const double y = 0.23 * i;
    const long double e = std::exp(static_cast<long double>(y));
    if (y > -700 && y < 709)
      worst = std::max(worst, static_cast<double>(std::abs(portable_exp(y) / e - 1) /
                                                  std::max(1.0L, std::abs(static_cast<long double>(y)))));
  }
  return worst;
}

// Identities that differ in one part must not meet: collisions among 2,000,000 of (frame, camera, pixel, ...).
double collisions(const StressOptions&) {
  std::vector<std::uint64_t> made;
  made.reserve(2'000'009);
  for (std::uint64_t frame = 0; frame < 200; ++frame)
    for (std::uint64_t camera = 0; camera < 100; ++camera)
      for (std::uint64_t pixel = 0; pixel < 100; ++pixel) made.push_back(hash_identity({frame, camera, pixel}));
  for (const std::uint64_t edge : {std::uint64_t{0}, ~std::uint64_t{0}, std::uint64_t{1} << 63}) {
    made.push_back(hash_identity({edge}));
    made.push_back(hash_identity({edge, 0}));
    made.push_back(hash_identity({0, 0, 0, edge}));
  }
  std::sort(made.begin(), made.end());
  return static_cast<double>(made.end() - std::unique(made.begin(), made.end()));
}

// Sample 1,000,000 asked for alone, and after a hundred others: how often it is another.
double samples_apart(const StressOptions&) {
  double wrong = 0;
  for (const std::uint64_t pixel : {0ull, 99ull})
    for (std::uint32_t pair = 0; pair < 8; ++pair) {
      const PixelSampler a(5, pixel), b(5, pixel);
      const vec2 late = a.get(pair, 1'000'000);
      for (std::uint32_t i = 0; i < 100; ++i) (void)b.get(pair, i);
      wrong += late != b.get(pair, 1'000'000);
    }
  return wrong;
}

}  // namespace

std::vector<StressCase> sampling_stress() {
  constexpr Oracle analytic = Oracle::analytic, precise = Oracle::high_precision, predicate = Oracle::exact_predicate;
  return {
      {"first sample of every pixel", "786,432 pixels, dimensions of the filter and of bounces 1 and 100, in 256 cells",
       analytic, 5, "sigma",
       "chi-squared of uniform numbers scatters by sqrt(2 x 255); beyond 5 sigma lies 1 in a million", first_samples},
      {"millionth sample", "2^20 samples of a pixel: intervals of 2^-20 and cells of 2^-10 by 2^-10", predicate, 0,
       "cells", "a (0, 2)-net in base 2 has exactly one sample in each", million_samples},
      {"last samples and last dimensions", "sample 2^32 - 1, dimension pair 2^32 - 1, pixel 2^64 - 1: 64 samples each",
       predicate, 0, "cells", "aligned blocks of a (0, 2)-sequence are nets anywhere in it", last_indices},
      {"dimensions of bounce 100", "correlated with those of the first bounce over 200,000 pixels", analytic, 5,
       "sigma", "the product of two centred uniform numbers has variance 1 / 144; beyond 5 sigma lies 1 in a million",
       far_dimensions},
      {"samples asked for out of order", "sample 1,000,000 alone, and after a hundred others", predicate, 0, "samples",
       "a sample is a function of its identity", samples_apart},
      {"all numbers 0 or the largest below 1: BSDF", "5 roughnesses, 6 angles down to 1e-30, 3 metalnesses", predicate,
       0, "corners", "directions are unit and above the surface, densities positive or 0, values finite",
       corners_of_bsdf},
      {"all numbers 0 or the largest below 1: lights",
       "maps with black borders, of one pixel, suns of 1e-4 to 1.5 rad, rectangles, the choice of a light", predicate,
       0, "corners", "directions are unit, densities finite, and no black pixel of a map is drawn", corners_of_lights},
      {"all numbers 0 or the largest below 1: filter and textures", "also at UVs of 1e30, infinity and not-a-number",
       predicate, 0, "corners", "the filter stays within its radius and monotone, texels within the image",
       corners_of_filter_and_texture},
      {"bits at both ends", "all bits 0, all 1, one at either end", predicate, 0, "numbers",
       "numbers lie in [0, 1), the largest is 1 - 2^-53 or 1 - 2^-24", ends_of_numbers},
      {"logarithm and exponential", "6,001 numbers from 1e-300 to 1e300", precise, 2e-15, "",
       "stated as about 1e-15: the last bits of a sum of two parts", portable_functions},
      {"collisions of identities", "2,000,009 tuples of frame, camera and pixel", predicate, 0, "collisions",
       "of 64-bit hashes 1e-7 are expected", collisions},
  };
}

}  // namespace moomill
