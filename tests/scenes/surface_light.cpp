// What scenes that gather light on their animals may ask for, and what others do not compute.
#include <doctest/doctest.h>

#include "scenes/generate.h"
#include "scenes/runner.h"
#include "tests/temporary_file.h"

using namespace moomill;
using namespace moomill::test;

namespace {

const std::string animal = "[[animals]]\nspecies = \"cow\"\n";

SceneSpec small(const std::string& modality, const std::string& more = "") {
  const TemporaryFile file("a.toml", "modalities = [\"" + modality + "\"]\n" + animal + more);
  // A map of one pixel, as the Radiance format writes it.
  std::ofstream(file.folder() / "one.hdr", std::ios::binary) << std::string("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\x80\x80\x80\x81");
  SceneSpec s = read_scene(file.path);
  Overrides o;
  o.coats = {0};
  o.resolution = {32, 24};
  o.samples = 1;
  o.cameras = {2};
  apply_overrides(s, o);
  s.render.coat_resolution = 64;
  return s;
}

std::string refusal(const std::string& light, bool in_file) {
  const TemporaryFile file("a.toml", animal + light + (in_file ? "[render]\nsurface_light = true\n" : ""));
  std::ofstream(file.folder() / "one.exr") << "exr";
  return message_of([&] {
    SceneSpec s = read_scene(file.path);
    if (in_file) return;
    Overrides o;
    o.surface_light = true;
    apply_overrides(s, o);
  });
}

}  // namespace

// Exit status 2 of such an error: tests/program/usage.cpp.
TEST_CASE("light gathered once per frame wants lights that stay for the frame") {
  for (const bool in_file : {true, false}) {
    CAPTURE(in_file);
    const auto names = [&](const std::string& light, const std::string& key) {
      const std::string m = refusal(light, in_file);
      INFO(m);
      CHECK(contains(m, "a.toml: " + key + " is drawn per view, but render.surface_light gathers light once per frame; draw it per frame or leave surface_light out"));
      CHECK(!contains(m, "\n"));
    };
    names("[light]\nenvironment_strength = {uniform = [1, 2], per = \"view\"}\n", "light.environment_strength");
    names("[light]\nenvironment_color = {uniform = [0, 1], per = \"view\"}\n", "light.environment_color");
    names("[light]\nenvironment_file = {choose = [\"one.exr\"], per = \"view\"}\n", "light.environment_file");
    names("[light]\nenvironment_file = \"one.exr\"\nenvironment_yaw_deg = {uniform = [0, 360], per = \"view\"}\n", "light.environment_yaw_deg");
    names("[[light.suns]]\nazimuth_deg = 3\n[[light.suns]]\nelevation_deg = {uniform = [10, 60], per = \"view\"}\n", "light.suns[1].elevation_deg");
    names("[[light.rectangles]]\nposition = [1, 2, 3]\nradiance = {uniform = [1, 2], per = \"view\"}\nwidth = 1\nheight = 1\n", "light.rectangles[0].radiance");
    // Drawn per frame, or what is no light per view.
    CHECK(refusal("[light]\nenvironment_strength = {uniform = [1, 2]}\n[[light.suns]]\nazimuth_deg = {uniform = [1, 2]}\n", in_file) == "(no error)");
    CHECK(refusal("[cameras]\nfocal_mm = {uniform = [50, 90], per = \"view\"}\n", in_file) == "(no error)");
  }
  CHECK(contains(refusal("[render]\nmax_bounces = 2\nsurface_light = true\n", false), "leave render.max_bounces = 2 out, or surface_light"));
  // Without surface_light a light may change with the view.
  CHECK(small("depth", "[light]\nenvironment_strength = {uniform = [1, 2], per = \"view\"}\n").light.environment_strength.per_view);
}

TEST_CASE("a sky map that cannot be read is refused before anything is written") {
  const TemporaryFile file("a.toml", "modalities = [\"rgb\"]\n" + animal + "[light]\nenvironment_file = \"bad.hdr\"\n");
  std::ofstream(file.folder() / "bad.hdr") << "not a map";
  SceneSpec s = read_scene(file.path);
  Overrides o;
  o.coats = {0};
  o.resolution = {32, 24};
  apply_overrides(s, o);
  s.render.coat_resolution = 64;
  GenerateOptions options;
  options.out = file.folder() / "out";
  CHECK(contains(message_of([&] { generate(s, options); }), "bad.hdr: is not a readable image"));
  CHECK_FALSE(std::filesystem::exists(options.out));
}

TEST_CASE("shares of the sky are computed where a sky lights a picture") {
  const auto geometry = [](const SceneSpec& s) {
    const Mill mill(s);
    return mill.prepare(1).geometry;
  };
  const auto even = geometry(small("rgb"));
  REQUIRE(even->sky.size() == even->scene.instances.size());
  CHECK(even->sky[0].size() == even->scene.instances[0].posed.positions.size());
  CHECK(geometry(small("depth"))->sky.empty());
  CHECK(geometry(small("rgb", "[light]\nenvironment_file = \"one.hdr\"\n"))->sky == even->sky);
}
