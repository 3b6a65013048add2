#include "validate/studies/leave_out.h"

#include <doctest/doctest.h>

#include <algorithm>

#include "generator/core/stage_times.h"

using namespace moomill;

namespace {

const Figure& figure(const StudyResult& r, const std::string& name) {
  const auto found = std::find_if(r.figures.begin(), r.figures.end(), [&](const Figure& f) { return f.name == name; });
  REQUIRE(found != r.figures.end());
  return *found;
}

Run run(double seconds, double depth, double peak) { return {seconds, peak, {{"encode depth", depth / 2}, {"labels depth", depth / 2}, {"light", 5}}}; }

}  // namespace

TEST_CASE("stages are timed while somebody listens, and only then") {
  { const StageTimer unheard("deaf"); }
  const StageTimes times;
  for (int i = 0; i < 2; ++i) {
    const StageTimer timer("labels", "depth");
    const double start = thread_processor_seconds();
    while (thread_processor_seconds() < start + 0.01) {
    }
  }
  const auto seconds = times.seconds();
  REQUIRE(seconds.size() == 1);
  CHECK(seconds.at("labels depth") >= 0.02);
  CHECK(seconds.at("labels depth") < 0.1);
}

TEST_CASE("a scene is left without each of its modalities, lights and coats") {
  const SceneSpec scene = read_scene(data_root() / "scenes/quick.toml");
  const auto variants = variants_of(scene);
  const auto find = [&](const std::string& part) {
    const auto v = std::find_if(variants.begin(), variants.end(), [&](const Variant& x) { return x.part == part; });
    CAPTURE(part);
    REQUIRE(v != variants.end());
    return *v;
  };
  CHECK(variants.size() == 8 + scene.light.suns.size() + scene.light.rectangles.size() + 1 + 2);
  const Variant depth = find("modality depth");
  CHECK_FALSE(depth.scene.modalities.has(Modality::depth));
  CHECK(depth.scene.modalities.has(Modality::rgb));
  CHECK(depth.stages == std::vector<std::string>{"encode depth", "labels depth", "depth"});
  const Variant coat = find("coat 11");
  CHECK(coat.scene.coat_indices == std::vector<int>{0});
  CHECK(std::find(coat.stages.begin(), coat.stages.end(), "bake coat 11_limousin") != coat.stages.end());
  CHECK(find("light environment").scene.light.environment_color.values[0][0] == 0);
  // The last modality stays: nothing would be made without it.
  SceneSpec one = scene;
  one.modalities = {};
  one.modalities.add(Modality::depth);
  CHECK(variants_of(one).empty());
}

TEST_CASE("savings are held against stage times where they are larger than the scatter") {
  LeaveOut l;
  l.variant = {"modality depth", {}, {"encode depth", "labels depth", "depth"}};
  for (const double noise : {0.0, 0.02, -0.01, 0.01, -0.02}) {
    l.with.push_back(run(10 + noise, 2, 300));
    l.without.push_back(run(8.1, 0, 280));
  }
  StudyResult r = leave_out_study("t", {l});
  const std::string ratio = "modality depth: time saved over the time its stages report";
  CHECK(figure(r, ratio).value == doctest::Approx(0.95));
  CHECK(figure(r, ratio).at_least == 0.9);
  CHECK(figure(r, "modality depth: peak memory saved").value == doctest::Approx(20));
  for (Run& x : l.without) x.seconds = 8.5;
  CHECK_FALSE(leave_out_study("t", {l}).holds());
  // Four pairs say too little.
  LeaveOut few = l;
  few.with.resize(4), few.without.resize(4);
  CHECK_FALSE(figure(leave_out_study("t", {few}), ratio).at_least);
  // Scatter of the order of the stage: told, not held.
  for (std::size_t i = 0; i < l.with.size(); ++i) l.with[i].seconds = 10 + 3.0 * i;
  CHECK_FALSE(figure(leave_out_study("t", {l}), ratio).at_least);
}
