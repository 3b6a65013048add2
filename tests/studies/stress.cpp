#include "validate/studies/stress.h"

#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <set>

#include "generator/core/error.h"

using namespace moomill;

namespace {

// Every case of a group, with fewer rays where cracks are hunted; one that leaves its bound is a regression.
void holds(const std::string& group) {
  StressOptions options;
  options.edge_rays = 100'000;
  options.group = group;
  for (const StressOutcome& o : run_stress(options)) {
    INFO(o.group << ": " << o.what.name << ": error " << o.error << ", allowed " << o.what.allowed << " " << o.failure);
    CHECK(o.holds());
  }
}

}  // namespace

TEST_CASE("stress: a wish to stop is heard between cases") {
  std::atomic<bool> stop{true};
  StressOptions options;
  options.stop = &stop;
  CHECK_THROWS_AS(run_stress(options), RunError);
}

TEST_CASE("stress: geometry stays within its bounds") {
  holds("geometry");
}
TEST_CASE("stress: skinning stays within its bounds") {
  holds("skinning");
}
TEST_CASE("stress: light stays within its bounds") {
  holds("light");
}
TEST_CASE("stress: sampling stays within its bounds") {
  holds("sampling");
}
TEST_CASE("stress: keypoints stay within their bounds") {
  holds("keypoints");
}
TEST_CASE("stress: statistics stay within their bounds") {
  holds("statistics");
}

TEST_CASE("stress: at least 60 cases, each named, explained and told apart") {
  std::size_t cases = 0;
  for (const std::string& group : stress_groups()) {
    std::set<std::string> names;
    for (const StressCase& c : stress_cases(group)) {
      INFO(group << ": " << c.name);
      CHECK(names.insert(c.name).second);
      CHECK_FALSE(c.what.empty());
      CHECK_FALSE(c.why.empty());
      ++cases;
    }
  }
  CHECK(cases >= 60);
  CHECK_THROWS_AS(stress_cases("tides"), InputError);
}

TEST_CASE("stress: what is out of bounds, not a number or thrown is told and never holds") {
  const auto outcome = [](const std::string& name, double error, const std::string& failure) {
    StressOutcome o;
    o.group = "light";
    o.what.name = name;
    o.what.what = "one, two | three";
    o.what.allowed = 1;
    o.error = error;
    o.failure = failure;
    return o;
  };
  const std::vector<StressOutcome> outcomes = {outcome("within", 0.5, ""), outcome("beyond", 2, ""),
                                               outcome("thrown", 0, "it fell over")};
  CHECK(outcomes[0].holds());
  CHECK_FALSE(outcomes[1].holds());
  CHECK_FALSE(outcomes[2].holds());
  const StudyResult study = stress_study(outcomes);
  CHECK_FALSE(study.holds());
  CHECK(study.figures.back().value == 2);
  const auto folder = std::filesystem::temp_directory_path() / "moomill_stress_test";
  std::filesystem::remove_all(folder);
  write_stress(outcomes, folder);
  const auto text = [&](const char* name) {
    std::ifstream in(folder / name);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  CHECK(text("stress.csv").find("light,beyond,\"one, two | three\",") != std::string::npos);
  CHECK(text("stress.md").find("one, two \\| three") != std::string::npos);
  CHECK(text("stress.md").find("failed: it fell over") != std::string::npos);
  std::filesystem::remove_all(folder);
}
