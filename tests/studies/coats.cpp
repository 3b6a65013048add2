#include "validate/studies/coats.h"

#include <doctest/doctest.h>

#include "generator/core/color.h"
#include "generator/core/error.h"
#include "scenes/scene.h"

using namespace moomill;

TEST_CASE("a coat does not differ from itself, and coats without colours of their own are refused") {
  const CoatComparison c = compare_coats("cow", {"00_holstein", "00_holstein", "10_white"});
  REQUIRE(c.pairs.size() == 3);
  CHECK(c.pairs[0].mean == 0);
  CHECK(c.pairs[0].share_above_20 == 0);
  CHECK(c.pairs[1].mean > 20);
  CHECK(c.pairs[1].mean == c.pairs[2].mean);
  // Half of it black: about that share differs by much.
  CHECK(c.pairs[1].share_above_20 > 0.35);
  CHECK(c.pairs[1].share_above_20 < 0.7);
  CHECK_THROWS_AS(compare_coats("cow", {"00_holstein", "own"}), InputError);
}

TEST_CASE("the cow's coats look as alike and as different as they should") {
  const StudyResult result = coat_study("cow");
  int alike = 0;
  for (const Figure& f : result.figures) {
    INFO(f.name << " " << f.value);
    CHECK(f.holds());
    alike += f.at_most.has_value();
  }
  CHECK(alike == 2);
  CHECK(result.figures.size() == 4 + 1 + 64);
}
