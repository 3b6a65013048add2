#include "validate/studies/individuals.h"

#include <doctest/doctest.h>

#include <algorithm>

#include "generator/core/color.h"
#include "generator/core/error.h"
#include "generator/core/random.h"

using namespace moomill;

namespace {

// Animals of two and more colours: blocks of dark, light and middling points.
SampledHerd made_up(int animals, int points) {
  SampledHerd herd;
  herd.points = points;
  for (int i = 0; i < animals; ++i)
    for (int p = 0; p < points; ++p) {
      // The last two animals nearly equal the first two.
      const std::uint64_t own = i >= animals - 2 && p > points / 50 ? i - (animals - 2) : i;
      const double u = to_unit(hash_identity({own, static_cast<std::uint64_t>(p / 16), 1}));
      const float jitter = static_cast<float>(to_unit(hash_identity({own, static_cast<std::uint64_t>(p), 2})));
      if (u < 0.45)
        herd.lab.push_back({15 + 10 * jitter, 1, 2});
      else if (u < 0.9)
        herd.lab.push_back({80 + 10 * jitter, 2, 8});
      else
        herd.lab.push_back({40 + 25 * jitter, 30 * jitter, 20});
    }
  return herd;
}

double plain_nearest(const SampledHerd& herd, int i) {
  double nearest = 1;
  for (int j = 0; j < herd.size(); ++j) {
    if (j == i) continue;
    int count = 0;
    for (int p = 0; p < herd.points; ++p) {
      const auto a = herd.of(i)[p], b = herd.of(j)[p];
      count += ciede2000({a[0], a[1], a[2]}, {b[0], b[1], b[2]}) > 20;
    }
    nearest = std::min(nearest, static_cast<double>(count) / herd.points);
  }
  return nearest;
}

}  // namespace

TEST_CASE("nearest neighbours by bits and CIEDE2000 agree with comparing every pair at every point") {
  const SampledHerd herd = made_up(40, 500);
  for (const double bar : {0.05, 0.4}) {
    const Neighbours found = nearest_neighbours(herd, bar);
    CHECK(found.pairs == 40 * 39 / 2);
    CHECK(found.exact > 0);
    int below = 0;
    for (int i = 0; i < herd.size(); ++i) {
      const double exact = plain_nearest(herd, i);
      CHECK((found.share[i] < bar) == (exact < bar));
      if (exact < bar)
        CHECK(found.share[i] == doctest::Approx(exact));
      else
        CHECK(found.share[i] <= exact + 1e-12);  // a lower bound, but not below the bar
      below += exact < bar;
    }
    CHECK(below >= 4);  // the twins
    CHECK(below < 40);
  }
}

TEST_CASE("points that bits tell apart differ by more than 20 for certain") {
  const Neighbours limits = nearest_neighbours(made_up(4, 64), 0.05);
  for (int l = 0; l <= 20; ++l)
    for (int k = 0; k < 400; ++k) {
      const auto u = [&](std::uint64_t d) { return to_unit(hash_identity({static_cast<std::uint64_t>(k), static_cast<std::uint64_t>(l), d})); };
      const dvec3 dark(limits.dark * l / 20, 200 * u(1) - 100, 200 * u(2) - 100);
      const dvec3 light(limits.light + (100 - limits.light) * u(3), 200 * u(4) - 100, 200 * u(5) - 100);
      CHECK(ciede2000(dark, light) > 20);
    }
}

TEST_CASE("individuals of Holstein differ, those of a plain breed are found alike") {
  const StudyResult holstein = individuals_study({"cow", "holstein", 60, 1});
  CHECK(holstein.holds());
  const StudyResult plain = individuals_study({"cow", "angus", 12, 1});
  CHECK_FALSE(plain.holds());
  CHECK(plain.figures[0].value == 0);
  CHECK_THROWS_AS(individuals_study({"cow", "no_such_breed", 12, 1}), InputError);
}
