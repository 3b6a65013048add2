// Every sampler against its density, and the BSDF against conservation of energy.
#include "generator/render/sampler.h"
#include "tests/render/fixtures.h"

using namespace moomill;
using namespace moomill::test;

namespace {
std::vector<double> linear_edges(double from, double to, int n) {
  std::vector<double> e;
  for (int i = 0; i <= n; ++i) e.push_back(from + (to - from) * i / n);
  return e;
}
constexpr double significance = 1e-4;  // of each test; a wrong density gives 1e-50
}  // namespace

TEST_CASE("pairs of dimensions are (0, 2)-nets: every elementary interval holds one of 2^k samples") {
  for (std::uint64_t pixel : {0ull, 17ull, 786431ull}) {
    const PixelSampler sampler(42, pixel);
    for (std::uint32_t pair : {0u, 1u, 9u})
      for (int k = 0; k <= 6; ++k)
        for (int a = 0; a <= k; ++a) {
          std::vector<int> count(1 << k, 0);
          for (int i = 0; i < 1 << k; ++i) {
            const vec2 u = sampler.get(pair, i);
            ++count[(int(u.x * (1 << a)) << (k - a)) + int(u.y * (1 << (k - a)))];
          }
          CHECK(*std::min_element(count.begin(), count.end()) == 1);
        }
  }
}

TEST_CASE("pairs of dimensions and pixels are not correlated") {
  double sum = 0, n = 0;
  for (int p = 0; p < 4000; ++p) {
    const PixelSampler a(1, p), b(1, p + 1);
    sum += (a.get(0, 0).x - 0.5) * (a.get(1, 0).x - 0.5) + (a.get(2, 3).y - 0.5) * (b.get(2, 3).y - 0.5);
    n += 2;
  }
  // Variance of a product of two centred uniforms: 1/144.
  CHECK(std::abs(sum / std::sqrt(n / 144)) < 4.0);
}

TEST_CASE("cosine hemisphere: chi-squared") {
  const Frame up(vec3(0, 0, 1));
  double mass = 0;
  const double p = chi_squared_of_directions([](vec2 u, vec3& d) { d = sample_cosine_hemisphere(u); return true; },
                                             [](const vec3& d) { return std::max(0.0f, d.z) / pi; }, up, linear_edges(-1, 1, 20), 16, 200000, 1, &mass);
  CHECK(mass == doctest::Approx(1).epsilon(1e-4));
  CHECK(p > significance);
}

TEST_CASE("GGX visible normals: chi-squared of the density D G1 (wo.h) / wo.z") {
  for (const float alpha : {0.05f, 0.3f, 1.0f})
    for (const float cosine : {0.1f, 0.7f, 1.0f}) {
      const vec3 wo(std::sqrt(1 - cosine * cosine), 0, cosine);
      auto density = [&](const vec3& h) {
        const double c = std::max(0.0f, glm::dot(wo, h)), t2 = (1 - wo.z * wo.z) / (wo.z * wo.z);
        const double g1 = 2 / (1 + std::sqrt(1 + alpha * alpha * t2));
        return h.z > 0 ? ggx_d(h, alpha) * g1 * c / wo.z : 0.0;
      };
      // Edges in cos(theta) that follow the lobe's width.
      std::vector<double> edges;
      for (int i = 0; i <= 16; ++i) {
        const double q = i / 16.0 * 0.995;
        edges.push_back(1 / std::sqrt(1 + alpha * alpha * q / (1 - q)));
      }
      edges.push_back(0);
      const double p = chi_squared_of_directions([&](vec2 u, vec3& d) { d = sample_ggx_visible_normal(wo, alpha, u); return true; },
                                                 density, Frame(vec3(0, 0, 1)), edges, 16, 200000, 2, nullptr, 48);
      CAPTURE(alpha);
      CAPTURE(cosine);
      CHECK(p > significance);
    }
}

TEST_CASE("BSDF sampling: chi-squared of sample() against pdf()") {
  for (const float roughness : {0.25f, 0.5f, 1.0f})
    for (const float metallic : {0.0f, 0.4f, 1.0f})
      for (const float cosine : {0.15f, 0.8f}) {
        const vec3 wo(0, std::sqrt(1 - cosine * cosine), cosine);
        const Bsdf bsdf(roughness, metallic, wo);
        const vec3 mirror(0, -wo.y, wo.z);  // cells around the highlight
        std::mt19937 lobe(7);
        std::vector<double> edges;
        for (int i = 0; i <= 40; ++i) edges.push_back(1 - 2 * std::pow(i / 40.0, 2.0));
        double mass = 0;
        const double p = chi_squared_of_directions(
            [&](vec2 u, vec3& d) {
              const BsdfSample s = bsdf.sample(u, float(lobe() >> 8) * 0x1p-24f);
              d = s.wi;
              return s.pdf > 0;
            },
            [&](const vec3& d) { return bsdf.pdf(d); }, Frame(mirror), edges, 24, 400000, 3, &mass, 40);
        CAPTURE(roughness);
        CAPTURE(metallic);
        CAPTURE(cosine);
        CHECK(mass < 1.001);
        CHECK(p > significance);
      }
}

TEST_CASE("environment map: chi-squared and unit mass, with a black row and a very bright texel") {
  ImageF map(16, 8, 3, 0.01f);  // dark enough that all else is bright and drawn from
  for (int y = 0; y < 8; y += 2)
    for (int x = y / 2 % 2; x < 16; x += 3)
      for (int c = 0; c < 3; ++c) map.at(x, y, c) = 0.3f * static_cast<float>(1 + (x + y + c) % 5);
  for (int x = 0; x < 16; ++x) map.at(x, 4, 0) = map.at(x, 4, 1) = map.at(x, 4, 2) = 0;
  map.at(3, 2, 1) = 50;
  map.at(12, 6, 0) = 4;
  const Environment env(map, "test", 1.5f, 33 * degrees);
  std::vector<double> edges;
  for (int i = 0; i <= 8; ++i) edges.push_back(std::cos(pi * i / 8));
  double mass = 0;
  // The map is turned; cells aligned with it keep the piecewise-constant density exact.
  const float a = static_cast<float>(33 * degrees);
  Frame frame(vec3(0, 0, 1));
  frame.x = {std::cos(a), std::sin(a), 0};
  frame.y = {-std::sin(a), std::cos(a), 0};
  const double p = chi_squared_of_directions([&](vec2 u, vec3& d) { d = env.sample(u).direction; return true; },
                                             [&](const vec3& d) { return env.pdf(d); }, frame, edges, 16, 400000, 4, &mass);
  CHECK(mass == doctest::Approx(1).epsilon(1e-3));
  CHECK(p > significance);
  std::mt19937 random(5);
  for (int i = 0; i < 1000; ++i) {
    const LightSample s = env.sample({float(random() >> 8) * 0x1p-24f, float(random() >> 8) * 0x1p-24f});
    CHECK(std::abs(glm::length(s.direction) - 1) < 1e-5);
    CHECK(luminance(s.radiance) > 0);
  }
}

TEST_CASE("environment map: a panorama seen from inside, not mirrored, turned counterclockwise by yaw") {
  ImageF map(8, 4, 3, 0.1f);
  for (int c = 0; c < 3; ++c) map.at(5, 1, c) = 9;  // right of the centre by 1.5 columns of 45 degrees, above the horizon
  const Environment env(map, "test", 1.0f, 0.0), turned(map, "test", 1.0f, 90 * degrees);
  const auto at = [](double azimuth_deg) {  // 22.5 degrees above the horizon
    const double a = azimuth_deg * degrees, e = 22.5 * degrees;
    return vec3(dvec3(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)));
  };
  // Who looks along -Y has -X at the right hand: azimuth falls from -90 to -157.5 degrees.
  CHECK(env.radiance(at(-157.5)).x == doctest::Approx(9));
  CHECK(env.radiance(at(-22.5)).x == doctest::Approx(0.1));
  CHECK(turned.radiance(at(-67.5)).x == doctest::Approx(9));
  for (const Environment* e : {&env, &turned})
    for (int i = 0; i < 50; ++i) {
      const LightSample s = e->sample({(i + 0.5f) / 50, 0.4f});
      CHECK(e->parts(s.direction).bright == s.radiance);
    }
}

TEST_CASE("environment map: a soft part at most twice its mean, a bright one with the rest, and the soft part's mean around a normal") {
  ImageF map(64, 32, 3);
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 64; ++x)
      for (int c = 0; c < 3; ++c) map.at(x, y, c) = (c + 1) * static_cast<float>(0.3 + 0.2 * std::cos(pi * (y + 0.5) / 32) + 0.1 * std::sin(2 * pi * (x + 0.5) / 64));
  for (int c = 0; c < 3; ++c) map.at(20, 9, c) = 900;
  const Environment env(map, "test", 1.0f, 0.4);
  CHECK(env.has_bright_part());
  dvec3 soft(0), bright(0), around[3] = {dvec3(0), dvec3(0), dvec3(0)};
  double brightest = 0;
  const dvec3 normals[3] = {{0, 0, 1}, glm::normalize(dvec3(1, -2, 0.5)), {0, 0.6, -0.8}};
  constexpr int n = 512;  // cells of equal solid angle
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < 2 * n; ++i) {
      const double z = 1 - 2 * (j + 0.5) / n, phi = pi * (i + 0.5) / n, s = std::sqrt(1 - z * z);
      const dvec3 d(s * std::cos(phi), s * std::sin(phi), z);
      const Environment::Parts p = env.parts(vec3(d));
      CHECK_MESSAGE(glm::length(p.soft + p.bright - env.radiance(vec3(d))) <= 1e-6f * glm::length(env.radiance(vec3(d))), "the parts are not the whole");
      CHECK(env.soft_radiance(vec3(d)) == p.soft);
      CHECK((p.bright == vec3(0) ? p.pdf < 1e-4f : p.pdf > 0));  // rounding of the tables leaves a little where nothing shines
      const double w = 1.0 / (2 * n * n);
      soft += w * dvec3(p.soft), bright += w * dvec3(p.bright);
      brightest = std::max({brightest, double(p.soft.x), double(p.soft.y), double(p.soft.z)});
      for (int k = 0; k < 3; ++k) around[k] += 4 * w * std::max(0.0, glm::dot(d, normals[k])) * dvec3(p.soft);
    }
  CHECK(brightest / soft.z == doctest::Approx(2).epsilon(0.01));  // blue is the brightest channel everywhere
  CHECK(luminance(vec3(soft)) > 0.5);               // of 0.56 without the bright pixel
  for (int c = 0; c < 3; ++c) CHECK(env.bright_mean()[c] == doctest::Approx(bright[c]).epsilon(0.03));
  for (int k = 0; k < 3; ++k)
    for (int c = 0; c < 3; ++c) CHECK(env.soft_around(vec3(normals[k]))[c] == doctest::Approx(around[k][c]).epsilon(0.01));
  // What is even has no bright part, what is dark but for little has no soft one.
  CHECK_FALSE(Environment(ImageF(8, 4, 3, 0.7f), "test", 2.0f, 0.1).has_bright_part());
  CHECK(Environment(ImageF(8, 4, 3, 0.7f), "test", 2.0f, 0.1).soft_around(vec3(0.6f, 0, 0.8f)).y == doctest::Approx(1.4).epsilon(1e-2));
  ImageF lamp(64, 32, 3, 0.0f);
  lamp.at(3, 9, 1) = 5;
  CHECK(luminance(Environment(lamp, "test", 1.0f, 0.0).soft_around(vec3(0, 0, 1))) < 1e-6);
  CHECK(Environment(vec3(0.2f)).soft_around(vec3(0, 0, -1)) == vec3(0.2f));
}

TEST_CASE("sun: chi-squared over its disc, and its radiance integrates to the irradiance") {
  Sun sun;
  sun.direction = glm::normalize(vec3(1, 2, 3));
  sun.angular_radius = 0.2f;
  sun.irradiance = {2, 3, 4};
  std::vector<double> edges;
  for (int i = 0; i <= 10; ++i) edges.push_back(1 - double(sun.one_minus_cos()) * i / 10);
  double mass = 0;
  const double p = chi_squared_of_directions([&](vec2 u, vec3& d) { d = sun.sample(u).direction; return true; },
                                             [&](const vec3& d) { return sun.pdf(d); }, Frame(sun.direction), edges, 12, 100000, 6, &mass);
  CHECK(mass == doctest::Approx(1).epsilon(2e-2));  // cells on the rim are cut
  CHECK(p > significance);
  double irradiance = 0;
  constexpr int n = 400;
  for (int i = 0; i < n; ++i) {
    const double z = 1 - double(sun.one_minus_cos()) * (i + 0.5) / n;
    irradiance += sun.radiance().y * z * 2 * pi * sun.one_minus_cos() / n;
  }
  CHECK(irradiance == doctest::Approx(3).epsilon(1e-4));
  sun.angular_radius = 0.00465f;
  CHECK(sun.pdf(sun.sample({0.999f, 0.3f}).direction) > 0);
}

TEST_CASE("rectangle: chi-squared of solid angles, and no light on its back") {
  RectangleLight light;
  light.corner = {-0.5f, -1, 2};
  light.edge_u = {0, 2, 0};
  light.edge_v = {1, 0, 0.5f};  // normal points down
  const vec3 from(0.2f, 0.1f, 0);
  REQUIRE(light.normal().z < 0);
  double mass = 0;
  const double p = chi_squared_of_directions([&](vec2 u, vec3& d) { d = light.sample(from, u).direction; return true; },
                                             [&](const vec3& d) {
                                               const auto t = light.intersect(from, d);
                                               return t ? double(light.pdf(d, *t)) : 0.0;
                                             },
                                             Frame(vec3(0, 0, 1)), linear_edges(0.5, 1, 12), 24, 300000, 8, &mass, 96);
  CHECK(mass == doctest::Approx(1).epsilon(5e-3));
  CHECK(p > significance);
  CHECK(light.sample({0, 0, 5}, {0.5f, 0.5f}).pdf == 0);
  CHECK_FALSE(light.intersect({0, 0, 5}, {0, 0, -1}).has_value());
}

TEST_CASE("pixel filter: moments of the Blackman-Harris window") {
  const PixelFilter filter(1.5);
  double mean = 0, variance = 0, expected = 0, total = 0;
  for (int i = 0; i < 100000; ++i) {
    const double x = filter.sample((i + 0.5f) / 100000);
    mean += x / 100000;
    variance += x * x / 100000;
    CHECK_MESSAGE(std::abs(x) <= 1.5, x);
  }
  for (int i = 0; i < 100000; ++i) {
    const double q = (i + 0.5) / 100000, a = 2 * pi * q, x = (2 * q - 1) * 1.5;
    const double w = 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a);
    expected += w * x * x;
    total += w;
  }
  CHECK(std::abs(mean) < 1e-4);
  CHECK(variance == doctest::Approx(expected / total).epsilon(1e-3));
}

TEST_CASE("white furnace: a white base reflects everything, for every roughness and angle") {
  double worst = 0;
  for (const float metallic : {0.0f, 0.5f, 1.0f})
    for (int r = 0; r <= 20; ++r)
      for (const float cosine : {0.02f, 0.05f, 0.1f, 0.2f, 0.4f, 0.6f, 0.8f, 0.95f, 1.0f}) {
        const float roughness = r / 20.0f;
        const vec3 wo(std::sqrt(1 - cosine * cosine), 0, cosine);
        const Bsdf bsdf(roughness, metallic, wo);
        double sum = 0;
        const int n = cosine < 0.15f ? 1 << 18 : 1 << 15;
        const PixelSampler sampler(9, r);
        for (int i = 0; i < n; ++i) {
          const BsdfSample s = bsdf.sample(sampler.get(0, i), sampler.get(1, i).x);
          if (s.pdf > 0) sum += bsdf.evaluate(s.wi).white() / s.pdf;
        }
        const double error = std::abs(sum / n - 1);
        CAPTURE(roughness);
        CAPTURE(metallic);
        CAPTURE(cosine);
        CHECK(error < 0.005);
        worst = std::max(worst, error);
      }
  MESSAGE("largest departure from 1: ", worst);
}

TEST_CASE("the BSDF is reciprocal for dielectrics") {
  std::mt19937 random(11);
  auto unit = [&] { return float(random() >> 8) * 0x1p-24f; };
  for (int i = 0; i < 500; ++i) {
    const vec3 a = sample_cosine_hemisphere({unit(), unit()}), b = sample_cosine_hemisphere({unit(), unit()});
    const float roughness = 0.1f + 0.9f * unit();
    const BaseResponse f = Bsdf(roughness, 0, a).evaluate(b), g = Bsdf(roughness, 0, b).evaluate(a);
    CHECK(f.at(0.5f) / b.z == doctest::Approx(g.at(0.5f) / a.z).epsilon(1e-3));
  }
}
