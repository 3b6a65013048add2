#include "scenes/generate.h"

#include <doctest/doctest.h>

#include "generator/core/data_root.h"
#include "scenes/runner.h"
#include "tests/temporary_file.h"

using namespace moomill;
using namespace moomill::test;

namespace {

PlanReport plan_of(const std::string& more) {
  const TemporaryFile file("a.toml", more);
  for (const char* name : {"rig.glb", "a.png", "b.png"}) std::ofstream(file.folder() / name) << "x";
  return plan(read_scene(file.path));
}

const Json& stage(const PlanReport& report, const std::string& name) {
  for (const Json& s : report.json["stages"])
    if (s["name"] == name) return s;
  throw std::runtime_error("no stage " + name);
}

}  // namespace

TEST_CASE("a plan counts views and images of what runs") {
  const PlanReport r = plan_of(
      "modalities = [\"rgb\", \"depth\", \"nnopcs\", \"keypoints\"]\n[frames]\ncount = 5\n"
      "[[animals]]\nspecies = \"rig.glb\"\ncoats = [\"own\", \"a.png\", \"b.png\"]\n");
  CHECK(r.json["views"] == 5 * 24 * 3);
  for (const Json& m : r.json["modalities"]) {
    if (m["name"] == "rgb") CHECK(m["files"] == 5 * 24 * 3);
    if (m["name"] == "depth") CHECK(m["files"] == 5 * 24);
    if (m["name"] == "nnopcs") CHECK(m["files"] == 5 * 24 * 2);
    if (m["name"] == "keypoints") CHECK(m["files"] == 0);
  }
  CHECK(r.json["modalities"].size() == 4);
  CHECK(stage(r, "path tracing")["runs"] == true);
  CHECK(r.json["bytes"] > 0);
  CHECK(r.json["seconds"] > 0);
  CHECK(contains(r.text, "5 frames x 24 cameras x 3 coats = 360 views of 1024 x 768"));
}

TEST_CASE("a plan names what is left out, and why") {
  const PlanReport depth = plan_of("modalities = [\"depth\"]\n[[animals]]\nspecies = \"rig.glb\"\n");
  for (const char* name : {"NNOPCS", "UVs", "coats", "lights", "path tracing", "keypoints", "occlusion", "coverage"}) {
    CHECK(stage(depth, name)["runs"] == false);
    CHECK_FALSE(stage(depth, name)["why"].get<std::string>().empty());
  }
  for (const char* name : {"rig", "poses", "skinning", "Embree hierarchy", "first hits", "encoders"})
    CHECK(stage(depth, name)["runs"] == true);
  CHECK(contains(depth.text, "path tracing      left out:  no chosen modality needs light"));
  const PlanReport points = plan_of("modalities = [\"keypoints\"]\n[[animals]]\nspecies = \"rig.glb\"\n");
  CHECK(stage(points, "encoders")["runs"] == false);
  CHECK(stage(points, "first hits")["runs"] == false);
  CHECK(stage(points, "keypoints")["runs"] == true);
}

TEST_CASE("a plan by a probe counts every part once") {
  SceneSpec scene = read_scene(data_root() / "scenes/quick.toml");
  Overrides small;
  small.resolution = {{64, 48}};
  small.samples = 4;
  apply_overrides(scene, small);
  const ProbeReport p = probe(scene, 0.2);
  CHECK(p.views >= 4);
  CHECK(p.samples == 4);
  for (const double part : {p.start.processor, p.start.elapsed, p.baking.processor, p.frame, p.labels, p.light, p.encoding}) CHECK(part > 0);
  CHECK(p.processor_seconds ==
        doctest::Approx(p.start.processor + p.baking.processor + 4 * p.frame + 96 * (p.labels + p.light + p.encoding)));
  const PlanReport report = plan(scene, &p);
  CHECK(report.json["processor_seconds"] == p.processor_seconds);
  CHECK(report.json["seconds"] == p.seconds);
  CHECK(contains(report.text, "after loading"));
}

TEST_CASE("the samples of a target error are those that pictures take, and a plan by a probe follows them") {
  SceneSpec scene = read_scene(data_root() / "scenes/quick.toml");
  Overrides small;
  small.resolution = {{64, 48}};
  apply_overrides(scene, small);
  double planned[2];
  int i = 0;
  for (const double error : {0.1, 0.02}) {
    CAPTURE(error);
    scene.render.target_error = error;
    const Mill mill(scene);
    const Frame frame = mill.prepare(1);
    const auto dressed = mill.dress(frame, 0);
    for (const std::size_t c : {2, 13, 21}) {
      // A picture's samples per pixel of the mask are more by the rim of the filter, as eight samples everywhere tell; the pilot's
      // eight are among them.
      const double rim = mill.trace_coats(frame, frame.cameras[c], *dressed, {8}).samples / 8;
      const double taken = mill.trace_coats(frame, frame.cameras[c], *dressed).samples;
      CHECK(mill.chosen_samples(frame, frame.cameras[c], *dressed) == doctest::Approx(taken / rim - 8).epsilon(1e-6));
    }
    const ProbeReport p = probe(scene, 0.2);
    planned[i++] = p.wanted_samples;
    CHECK(contains(plan(scene, &p).text, fmt::format("about {:.0f} per pixel in the mean", p.wanted_samples)));
  }
  CHECK(planned[0] >= 4);
  CHECK(planned[1] > 4 * planned[0]);
}

TEST_CASE("a clip that does not exist is refused by probe and generate, which leaves nothing behind") {
  const TemporaryFile file("a.toml", "modalities = [\"depth\"]\n[[animals]]\nspecies = \"cow\"\nposes = [{clip = \"walk\", count = 2}, {clip = \"wlak\", count = 2}]\n");
  const SceneSpec scene = read_scene(file.path);
  const std::string says = "has no clip 'wlak'";
  CHECK(contains(message_of([&] { probe(scene, 0.1); }), says));
  GenerateOptions options;
  options.out = file.folder() / "out";
  CHECK(contains(message_of([&] { generate(scene, options); }), says));
  CHECK_FALSE(std::filesystem::exists(options.out));
}
