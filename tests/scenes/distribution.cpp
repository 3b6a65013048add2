#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "scenes/scene.h"

using namespace moomill;

namespace {

Distribution make(Choice::Kind kind, std::vector<std::vector<double>> values, const char* key = "light.x") {
  Distribution d;
  d.kind = kind;
  d.values = std::move(values);
  d.key = key;
  return d;
}

struct Moments {
  double mean = 0, variance = 0, lowest = 1e300, highest = -1e300;
};

Moments moments(const Distribution& d, int n, bool logarithm = false) {
  Moments m;
  double squares = 0;
  for (int frame = 0; frame < n; ++frame) {
    double x = draw_number(d, 17, frame, 0);
    m.lowest = std::min(m.lowest, x);
    m.highest = std::max(m.highest, x);
    if (logarithm) x = std::log(x);
    m.mean += x / n;
    squares += x * x / n;
  }
  m.variance = squares - m.mean * m.mean;
  return m;
}

constexpr int draws = 40000;

// Both z-tests; `fourth` is the fourth central moment over the squared variance.
void check_moments(const Moments& m, double mean, double variance, double fourth) {
  CHECK(std::abs(m.mean - mean) < 5 * std::sqrt(variance / draws));
  CHECK(std::abs(m.variance - variance) < 5 * variance * std::sqrt((fourth - 1) / draws));
}

}  // namespace

TEST_CASE("a uniform distribution has its mean and variance and stays within its bounds") {
  const Moments m = moments(make(Choice::Kind::uniform, {{-1}, {3}}), draws);
  check_moments(m, 1, 16 / 12.0, 1.8);
  CHECK(m.lowest >= -1);
  CHECK(m.highest <= 3);
}

TEST_CASE("a normal distribution has its mean and variance, a clamp holds") {
  check_moments(moments(make(Choice::Kind::normal, {{5}, {2}}), draws), 5, 4, 3);
  const Moments clamped = moments(make(Choice::Kind::normal, {{5}, {2}, {4}, {7}}), draws);
  CHECK(clamped.lowest == 4);
  CHECK(clamped.highest == 7);
}

TEST_CASE("a log-uniform distribution is uniform in the logarithm") {
  const double a = std::log(0.1), b = std::log(100.0);
  const Moments m = moments(make(Choice::Kind::log_uniform, {{0.1}, {100}}), draws, true);
  check_moments(m, (a + b) / 2, (b - a) * (b - a) / 12, 1.8);
  CHECK(m.lowest >= 0.1);
  CHECK(m.highest <= 100);
}

TEST_CASE("choose takes every entry equally often, and whole") {
  const Distribution d = make(Choice::Kind::choose, {{1, 2, 3}, {4, 5, 6}, {7, 8, 9}});
  int count[3] = {0, 0, 0};
  for (int frame = 0; frame < draws; ++frame) {
    const dvec3 v = draw_vector(d, 3, frame, 0);
    REQUIRE(v.y == v.x + 1);
    REQUIRE(v.z == v.x + 2);
    ++count[static_cast<int>(v.x) / 3];
  }
  for (const int c : count) CHECK(std::abs(c - draws / 3.0) < 5 * std::sqrt(draws * 2 / 9.0));
  Distribution words;
  words.kind = Choice::Kind::choose;
  words.words = {"a", "b"};
  std::set<std::string> seen;
  for (int frame = 0; frame < 50; ++frame) seen.insert(draw_text(words, 3, frame, 0));
  CHECK(seen.size() == 2);
}

TEST_CASE("components of a vector are drawn apart, a grey is drawn once") {
  const Distribution vector = make(Choice::Kind::uniform, {{0, 0, 0}, {1, 1, 1}});
  double product = 0;
  for (int frame = 0; frame < draws; ++frame) {
    const dvec3 v = draw_vector(vector, 3, frame, 0);
    product += (v.x - 0.5) * (v.y - 0.5);
  }
  CHECK(std::abs(product / draws) < 5 / 12.0 / std::sqrt(draws));
  const dvec3 grey = draw_vector(make(Choice::Kind::uniform, {{0}, {1}}), 3, 9, 0);
  CHECK(grey.x == grey.y);
  CHECK(grey.x == grey.z);
}

TEST_CASE("a draw depends on seed, key, frame and, per view, camera, never on order") {
  Distribution d = make(Choice::Kind::uniform, {{0}, {1}});
  const double x = draw_number(d, 1, 2, 3);
  CHECK(draw_number(d, 1, 2, 4) == x);
  CHECK(draw_number(d, 2, 2, 3) != x);
  CHECK(draw_number(d, 1, 3, 3) != x);
  Distribution other = d;
  other.key = "light.y";
  CHECK(draw_number(other, 1, 2, 3) != x);
  d.per_view = true;
  CHECK(draw_number(d, 1, 2, 4) != draw_number(d, 1, 2, 3));
  std::vector<double> forwards, backwards;
  for (int f = 0; f < 100; ++f) forwards.push_back(draw_number(d, 1, f, f % 5));
  for (int f = 99; f >= 0; --f) backwards.push_back(draw_number(d, 1, f, f % 5));
  std::reverse(backwards.begin(), backwards.end());
  CHECK(forwards == backwards);
}

TEST_CASE("draws are pinned: a change here changes every dataset") {
  const Distribution d = make(Choice::Kind::uniform, {{0}, {1}});
  const Distribution n = make(Choice::Kind::normal, {{0}, {1}});
  const Distribution l = make(Choice::Kind::log_uniform, {{1}, {10}});
  CHECK(draw_number(d, 1, 2, 3) == 0x1.5c12940f6a7e7p-1);
  CHECK(draw_number(n, 1, 2, 3) == 0x1.1ebc253a8cb24p+0);
  CHECK(draw_number(l, 1, 2, 3) == 0x1.3233ed60c26c9p+2);
}
