// Chi-squared tests of the samplers that tests/render/sampling.cpp leaves out: every draw of the path tracer has one, here or there.
#include "generator/render/path_kernel.h"
#include "generator/render/sampler.h"
#include "tests/render/fixtures.h"

using namespace moomill;
using namespace moomill::test;

namespace {
constexpr double significance = 1e-4;  // of each test

// Pearson's test; cells that expect fewer than five are pooled.
double pearson(const std::vector<double>& observed, const std::vector<double>& expected) {
  double statistic = 0, rest_observed = 0, rest_expected = 0;
  int cells = 0;
  const auto add = [&](double o, double e) { statistic += (o - e) * (o - e) / e, ++cells; };
  for (std::size_t i = 0; i < expected.size(); ++i) {
    if (expected[i] < 5)
      rest_observed += observed[i], rest_expected += expected[i];
    else
      add(observed[i], expected[i]);
  }
  if (rest_expected >= 5)
    add(rest_observed, rest_expected);
  else
    CHECK(rest_observed < 30);
  return chi_squared_p(statistic, cells - 1);
}

struct Numbers {
  std::mt19937 random;
  float operator()() { return static_cast<float>(random() >> 8) * 0x1p-24f; }
};
}  // namespace

TEST_CASE("low-discrepancy samples: uniform over pixels, in one pair and jointly in two pairs and two pixels") {
  for (const std::uint32_t index : {0u, 1u, 63u, 1000003u}) {
    std::vector<double> pair(32 * 32, 0.0), pairs(256, 0.0), samples(256, 0.0), neighbours(256, 0.0);
    constexpr int n = 200000;
    for (int p = 0; p < n; ++p) {
      const PixelSampler a(99, 2 * p), b(99, 2 * p + 1);
      const vec2 u = a.get(3, index), v = a.get(8, index), w = a.get(3, index + 1), x = b.get(3, index);
      const auto joint = [](const vec2& s, const vec2& t) { return ((int(4 * s.x) * 4 + int(4 * s.y)) * 4 + int(4 * t.x)) * 4 + int(4 * t.y); };
      ++pair[int(32 * u.x) * 32 + int(32 * u.y)];
      ++pairs[joint(u, v)];
      ++neighbours[joint(u, x)];
      ++samples[int(16 * w.x) * 16 + int(16 * w.y)];
    }
    CAPTURE(index);
    CHECK(pearson(pair, std::vector<double>(pair.size(), n / 1024.0)) > significance);
    CHECK(pearson(pairs, std::vector<double>(256, n / 256.0)) > significance);
    CHECK(pearson(neighbours, std::vector<double>(256, n / 256.0)) > significance);
    CHECK(pearson(samples, std::vector<double>(256, n / 256.0)) > significance);
  }
}

TEST_CASE("low-discrepancy samples of an image's pixels: uniform over streams, in one pair and jointly in two pairs and two neighbours") {
  for (const int samples : {1, 16, 100}) {
    std::vector<double> pair(32 * 32, 0.0), pairs(256, 0.0), apart(256, 0.0);
    constexpr int n = 100000;
    const int index = samples - 1;
    for (int stream = 0; stream < n; ++stream) {
      const PixelSampler a = PixelSampler::in_image(mix64(stream), 37, 90, samples), b = PixelSampler::in_image(mix64(stream), 600, 91, samples);
      const vec2 u = a.get(3, index), v = a.get(8, index), w = b.get(3, index);
      const auto joint = [](const vec2& s, const vec2& t) { return ((int(4 * s.x) * 4 + int(4 * s.y)) * 4 + int(4 * t.x)) * 4 + int(4 * t.y); };
      ++pair[int(32 * u.x) * 32 + int(32 * u.y)];
      ++pairs[joint(u, v)];
      ++apart[joint(u, w)];  // of another block of 256 pixels: independent; within a block they are stratified against each other
    }
    CAPTURE(samples);
    CHECK(pearson(pair, std::vector<double>(pair.size(), n / 1024.0)) > significance);
    CHECK(pearson(pairs, std::vector<double>(256, n / 256.0)) > significance);
    CHECK(pearson(apart, std::vector<double>(256, n / 256.0)) > significance);
  }
}

TEST_CASE("pixel filter: chi-squared against the Blackman-Harris window") {
  for (const double radius : {0.5, 1.5, 3.0}) {
    CAPTURE(radius);
    const PixelFilter filter(radius);
    constexpr int cells = 60, fine = 1000, n = 400000;
    std::vector<double> weight(cells, 0.0), seen(cells, 0.0);
    Numbers xi{std::mt19937(8)};
    for (int i = 0; i < n; ++i) ++seen[std::clamp(int((filter.sample(xi()) / radius + 1) / 2 * cells), 0, cells - 1)];
    double total = 0;
    for (int k = 0; k < fine * cells; ++k) {
      const double a = 2 * pi * (k + 0.5) / (fine * cells), w = 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a);
      weight[k / fine] += w;
      total += w;
    }
    std::vector<double> expected;
    for (int k = 0; k < cells; ++k) expected.push_back(n * weight[k] / total);
    // The tails on their own: what lies outside of `edge` of the half width is drawn by xi below the window's integral there.
    const auto integral_to = [](double x) {  // from the left end, x in [0, 1] of the width
      return x - (0.48829 * std::sin(2 * pi * x) - 0.14128 / 2 * std::sin(4 * pi * x) + 0.01168 / 3 * std::sin(6 * pi * x)) / (2 * pi * 0.35875);
    };
    for (const double edge : {0.15, 0.04}) {  // xi below 0.0047 and 0.000018
      constexpr int parts = 40;
      const double share = integral_to(edge);
      std::vector<double> left(parts, 0.0), right(parts, 0.0), tail;
      for (int k = 0; k < parts; ++k) tail.push_back(100000 * (integral_to(edge * (k + 1) / parts) - integral_to(edge * k / parts)) / share);
      std::mt19937 random(11);
      for (int i = 0; i < 100000; ++i) {
        const double u = share * (random() + 0.5) * 0x1p-32;
        const double at = (filter.sample(static_cast<float>(u)) / radius + 1) / 2;
        ++left[std::clamp(int(at / edge * parts), 0, parts - 1)];
        // Floats near 1 are too coarse for the far tail, so the right one is the mirrored left one.
        if (edge > 0.1) ++right[std::clamp(int((1 - filter.sample(static_cast<float>(1 - u)) / radius) / 2 / edge * parts), 0, parts - 1)];
      }
      CAPTURE(edge);
      CHECK(pearson(left, tail) > significance);
      if (edge > 0.1) CHECK(pearson(right, tail) > significance);
    }
    // weight() is the same window, as a density.
    double integral = 0;
    for (int k = 0; k < 2000; ++k) {
      const double x = radius * (2 * (k + 0.5) / 2000 - 1), a = 2 * pi * (k + 0.5) / 2000, w = filter.weight(static_cast<float>(std::abs(x)));
      CHECK_MESSAGE(std::abs(w - (0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a)) / (2 * radius * 0.35875)) < 1e-5, x);
      integral += w * 2 * radius / 2000;
    }
    CHECK(integral == doctest::Approx(1).epsilon(1e-5));
    CHECK(pearson(seen, expected) > significance);
  }
}

TEST_CASE("rectangle: chi-squared over its area of sample() against pdf() in solid angle, near, far and grazing; intersect() finds the same point") {
  RectangleLight r;
  r.corner = {1, -2, 3};
  r.edge_u = {0, 2, 0.5f};
  r.edge_v = {1.5f, 0.3f, 0};
  const vec3 n = r.normal(), centre = r.corner + 0.5f * (r.edge_u + r.edge_v);
  const vec3 aside = glm::normalize(r.edge_u);
  for (const vec3& from : {centre + 0.3f * n, centre + 6.0f * n + aside, centre + 0.2f * n + 3.0f * aside}) {
    constexpr int cells = 16, draws = 200000, sub = 16;
    std::vector<double> observed(cells * cells, 0.0), expected(cells * cells, 0.0);
    Numbers xi{std::mt19937(3)};
    int wrong = 0;
    for (int i = 0; i < draws; ++i) {
      const LightSample s = r.sample(from, {xi(), xi()});
      wrong += !(s.pdf > 0) || s.radiance != r.radiance;
      const auto t = r.intersect(from, s.direction);
      if (!t) continue;  // on the rim; the cell lacks it
      wrong += std::abs(*t / s.distance - 1) > 1e-3;
      const dvec3 p = dvec3(from) + double(s.distance) * dvec3(s.direction) - dvec3(r.corner);
      // Coordinates along edges that are not at right angles.
      const dvec3 u(r.edge_u), v(r.edge_v), nn = glm::cross(u, v);
      const double a = glm::dot(glm::cross(p, v), nn) / glm::dot(nn, nn), b = glm::dot(glm::cross(u, p), nn) / glm::dot(nn, nn);
      ++observed[std::clamp(int(a * cells), 0, cells - 1) * cells + std::clamp(int(b * cells), 0, cells - 1)];
    }
    double mass = 0;
    for (int i = 0; i < cells * sub; ++i)
      for (int j = 0; j < cells * sub; ++j) {
        const dvec3 d = dvec3(r.corner) + (i + 0.5) / (cells * sub) * dvec3(r.edge_u) + (j + 0.5) / (cells * sub) * dvec3(r.edge_v) - dvec3(from);
        const double distance = glm::length(d), solid_angle = -glm::dot(d, glm::cross(dvec3(r.edge_u), dvec3(r.edge_v))) / std::pow(distance, 3);
        const double e = r.pdf(vec3(d / distance), static_cast<float>(distance)) * solid_angle / (cells * sub * cells * sub);
        expected[i / sub * cells + j / sub] += e * draws;
        mass += e;
      }
    CHECK(wrong == 0);
    CHECK(mass == doctest::Approx(1).epsilon(1e-4));
    CHECK(pearson(observed, expected) > significance);
  }
}

TEST_CASE("choice of a light: chi-squared against nine tenths by irradiance and one tenth evenly, and the chance is in the density") {
  Lights lights;
  ImageF map(8, 4, 3, 0.05f);  // evenly, which is not sampled, but for one pixel
  for (int c = 0; c < 3; ++c) map.at(2, 1, c) = 0.9f;
  lights.environment = std::make_shared<Environment>(map, "test", 1.0f, 0.0);
  lights.suns = {{vec3(0, 0, 1), vec3(3), 0.01f}, {vec3(1, 0, 0), vec3(0.5f), 0.02f}};
  RectangleLight r;
  r.corner = {-1, -1, 4};
  r.edge_u = {0, 2, 0};
  r.edge_v = {2, 0, 0};
  r.radiance = vec3(5);
  lights.rectangles = {r};
  lights.prepare(vec3(0));
  const std::vector<double> power = {lights.environment->bright_mean().x * pi, 3, 0.5, 5 * 4.0 / 16};
  double total = 0;
  for (double p : power) total += p;
  constexpr int n = 200000;
  std::vector<double> observed(4, 0.0), expected, alone(4, 0.0);
  for (double p : power) expected.push_back(n * (0.9 * p / total + 0.1 / 4));
  Numbers xi{std::mt19937(12)};
  int wrong = 0;
  for (int i = 0; i < n; ++i) {
    const LightSample s = lights.sample(vec3(0), xi(), {xi(), xi()});
    const int k = !std::isinf(s.distance) ? 3 : s.radiance.x < 1 ? 0 : s.direction.z > 0.9f ? 1 : 2;
    ++observed[k];
    const double density = k == 0   ? lights.environment->pdf(s.direction)
                           : k == 3 ? r.pdf(s.direction, s.distance)
                                    : lights.suns[k - 1].pdf(s.direction);
    wrong += density > 0 && std::abs(s.pdf / (density * expected[k] / n) - 1) > 1e-3;  // 0: on a rim
  }
  CHECK(wrong == 0);
  CHECK(pearson(observed, expected) > significance);
}

TEST_CASE("all four texels: the mean that the choice of one has, of the colour and of its square, with the same bits on a stack and without") {
  constexpr int w = 5, h = 4, coats = 3;
  std::mt19937 random(9);
  std::vector<Image8> images(coats, Image8(w, h, 3));
  for (Image8& im : images)
    for (auto& v : im.data) v = static_cast<std::uint8_t>(random() & 255);
  Paint single, stacked;
  std::vector<std::shared_ptr<const Texture>> textures;
  for (const Wrap mode : {Wrap::repeat, Wrap::mirror, Wrap::clamp}) {
    TexturePlacement place;
    place.wrap_u = place.wrap_v = mode;
    place.scale = {1.5f, 0.8f};
    single = stacked = {};
    textures.clear();
    std::vector<const Image8*> all;
    for (int c = 0; c < coats; ++c) {
      Texture t;
      t.image = images[c];
      t.placement = place;
      textures.push_back(std::make_shared<const Texture>(t));
      single.coats.push_back({vec3(1), c, false});
      all.push_back(&images[c]);
    }
    stacked.coats = single.coats;
    stacked.stack_placement = place;
    build_stack(stacked, all);
    const auto fetch = [&](const Paint& paint, const vec2& uv, const vec2& xi, bool all_four) {
      __m256 base[3], square[3];
      kernel::fetch_eight(find_paint(paint, uv, vec3(1), xi, all_four), textures, srgb_table().data(), 0, base, square);
      std::array<float, 6 * coats> out;
      alignas(32) float lanes[8];
      for (int c = 0; c < 6; ++c) {
        _mm256_store_ps(lanes, c < 3 ? base[c] : square[c - 3]);
        std::copy_n(lanes, coats, out.begin() + c * coats);
      }
      return out;
    };
    for (const vec2& uv : {vec2(0.31f, 0.77f), vec2(0.02f, 0.99f), vec2(-1.4f, 2.63f)}) {
      const auto four = fetch(stacked, uv, vec2(0.5f), true);
      CHECK(four == fetch(single, uv, vec2(0.5f), true));
      std::array<double, 6 * coats> mean{};
      constexpr int n = 200;
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
          const vec2 xi((i + 0.5f) / n, (j + 0.5f) / n);
          const auto one = fetch(stacked, uv, xi, false);
          if (i == j) CHECK(one == fetch(single, uv, xi, false));
          for (std::size_t k = 0; k < mean.size(); ++k) mean[k] += double(one[k]) / (n * n);
        }
      for (std::size_t k = 0; k < mean.size(); ++k) CHECK(std::abs(four[k] - mean[k]) < 0.01);  // the grid's step
    }
  }
}

TEST_CASE("choice of a texel: chi-squared against bilinear weights, for every wrap mode, turned and shifted") {
  for (const Wrap mode : {Wrap::repeat, Wrap::mirror, Wrap::clamp})
    for (const vec2& uv : {vec2(0.31f, 0.77f), vec2(0.02f, 0.99f), vec2(-1.4f, 2.63f)})
      for (const float turn : {0.0f, 0.7f}) {
        TexturePlacement place;
        place.wrap_u = place.wrap_v = mode;
        place.rotation = turn;
        place.offset = {0.1f, -0.2f};
        place.scale = {1.5f, 0.8f};
        constexpr int w = 5, h = 4, n = 50000;
        // glTF's texture transform (KHR_texture_transform), then the four texels around.
        const double c = std::cos(double(turn)), s = std::sin(double(turn)), u = uv.x * 1.5, v = uv.y * 0.8f;
        const double x = (c * u + s * v + 0.1f) * w - 0.5, y = (-s * u + c * v - 0.2f) * h - 0.5;
        const auto wrapped = [&](int i, int size) {
          if (mode == Wrap::clamp) return std::clamp(i, 0, size - 1);
          if (mode == Wrap::repeat) return ((i % size) + size) % size;
          const int k = ((i % (2 * size)) + 2 * size) % (2 * size);
          return k < size ? k : 2 * size - 1 - k;
        };
        std::vector<double> expected(w * h, 0.0), observed(w * h, 0.0);
        for (int dx = 0; dx < 2; ++dx)
          for (int dy = 0; dy < 2; ++dy) {
            const double fx = x - std::floor(x), fy = y - std::floor(y);
            expected[wrapped(int(std::floor(y)) + dy, h) * w + wrapped(int(std::floor(x)) + dx, w)] += n * (dx ? fx : 1 - fx) * (dy ? fy : 1 - fy);
          }
        Numbers xi{std::mt19937(21)};
        for (int i = 0; i < n; ++i) {
          const glm::ivec2 t = choose_texel(place, w, h, uv, {xi(), xi()});
          ++observed[t.y * w + t.x];
        }
        int cells = 0;
        for (double e : expected) cells += e >= 5;
        for (std::size_t i = 0; i < expected.size(); ++i)
          if (expected[i] == 0) CHECK(observed[i] == 0);
        if (cells >= 2) CHECK(pearson(observed, expected) > significance);
      }
}

TEST_CASE("BSDF sampling with a specular factor, and narrow lobes: chi-squared of sample() against pdf()") {
  struct Case {
    float roughness, metallic, specular;
  };
  for (const Case& c : {Case{0.5f, 0, 0}, Case{0.5f, 0, 0.4f}, Case{0.3f, 0.5f, 0.2f}, Case{0.12f, 0, 1}, Case{0.12f, 1, 1}})
    for (const float cosine : {0.3f, 0.9f}) {
      const vec3 wo(0, std::sqrt(1 - cosine * cosine), cosine), mirror(0, -wo.y, wo.z);
      const Bsdf bsdf(c.roughness, c.metallic, wo, c.specular);
      std::vector<double> edges;
      for (int i = 0; i <= 60; ++i) edges.push_back(1 - 2 * std::pow(i / 60.0, 4.0));
      Numbers lobe{std::mt19937(7)};
      double mass = 0;
      const double p = chi_squared_of_directions(
          [&](vec2 u, vec3& d) {
            const BsdfSample s = bsdf.sample(u, lobe());
            d = s.wi;
            return s.pdf > 0;
          },
          [&](const vec3& d) { return bsdf.pdf(d); }, Frame(mirror), edges, 24, 300000, 3, &mass, 24);
      CAPTURE(c.roughness);
      CAPTURE(c.specular);
      CAPTURE(cosine);
      CHECK(mass < 1.002);
      CHECK(p > significance);
    }
}
