// The kit of parts, on a small body: every part makes a closed union with it, and its measures are what they say.
#include "rigs/parts.h"

#include <doctest/doctest.h>

#include <array>
#include <map>

#include "generator/core/error.h"

using namespace moomill;

namespace {

// A barrel with a head joint at its front and one leg per side, whose foot joint is 0.08 m above the ground.
QuadrupedSpec barrel() {
  QuadrupedSpec spec;
  spec.source = "barrel";
  spec.target_edge = 0.02;
  spec.grid = 0.008;
  spec.joints = {{"root", "", {0, 0, 0.45}},
                 {"head", "root", {0.2, 0, 0.45}},
                 {"ear_l", "head", {0.2, 0.1, 0.5}, true},
                 {"left_fore_fetlock", "root", {0, 0.12, 0.15}, true},
                 {"left_fore_hoof", "left_fore_fetlock", {0, 0.12, 0.08}, true}};
  Solid trunk;
  trunk.name = "trunk";
  trunk.cap_start = trunk.cap_end = 0.12;
  trunk.sections = {{{-0.2, 0, 0.45}, 0.12, 0.12, 0.12, 2, "root", "torso"}, {{0.2, 0, 0.45}, 0.12, 0.12, 0.12, 2, "head", "head"}};
  Solid leg;
  leg.name = "leg";
  leg.up = {1, 0, 0};
  leg.mirror = true;
  leg.sections = {{{0, 0.10, 0.40}, 0.05, 0.05, 0.05, 2, "root", "fore_left_upper"},
                  {{0, 0.12, 0.08}, 0.035, 0.035, 0.035, 2, "left_fore_hoof"}};
  leg.cap_end = 0.01;
  spec.solids = {trunk, leg};
  return spec;
}

Rig build_with(const std::vector<PartSpec>& parts, QuadrupedSpec spec = barrel()) {
  for (const Solid& s : expand_parts(parts, spec)) spec.solids.push_back(s);
  return build_quadruped(spec);
}

// Edges that have no twin in the other direction, or occur twice.
int open_edges(const Surface& s) {
  std::map<std::array<float, 3>, int> seen;
  std::vector<int> id;
  for (const vec3& p : s.rest)
    id.push_back(seen.try_emplace({p.x, p.y, p.z}, static_cast<int>(seen.size())).first->second);
  std::map<std::pair<int, int>, int> edges;
  for (const uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k) ++edges[{id[t[k]], id[t[(k + 1) % 3]]}];
  int wrong = 0;
  for (const auto& [edge, count] : edges) wrong += count != 1 || !edges.count({edge.second, edge.first});
  return wrong;
}

// The box of the triangles of one body part.
Box box_of(const Rig& rig, const std::string& part) {
  Box box;
  for (std::size_t t = 0; t < rig.surface.triangles.size(); ++t)
    if (rig.part_names[rig.surface.parts[t]] == part)
      for (int k = 0; k < 3; ++k) box.add(dvec3(rig.surface.rest[rig.surface.triangles[t][k]]));
  return box;
}

PartSpec make(const std::string& joint, const dvec3& offset, decltype(PartSpec::kind) kind) {
  PartSpec p;
  p.name = "the part";
  p.joint = joint;
  p.offset = offset;
  p.kind = kind;
  return p;
}

}  // namespace

TEST_CASE("every part makes a closed union with the body, on both sides alike") {
  const std::vector<std::pair<std::string, PartSpec>> kit = {
      {"eye_l", make("head", {0, 0.12, 0.02}, EyePart{})},
      {"ear_l", make("ear_l", {0, 0, 0}, EarPart{})},
      {"muzzle", make("head", {0.11, 0.04, 0}, NostrilPart{})},
      {"hoof_fore_left", make("left_fore_hoof", {}, HoofPart{})},
      {"hoof_fore_left", make("left_fore_fetlock", {-0.04, 0, 0}, DewclawPart{})},
  };
  for (const auto& [name, part] : kit) {
    INFO(name);
    const Rig rig = build_with({part});
    CHECK(open_edges(rig.surface) == 0);
    const Box left = box_of(rig, name), right = box_of(rig, mirror_name(name));
    REQUIRE(!left.empty());
    CHECK(left.lower.y == doctest::Approx(-right.upper.y));
    CHECK(left.size().z == doctest::Approx(right.size().z));
  }
}

TEST_CASE("a hoof is as wide, long and high as asked, and stands on the ground") {
  for (const bool cloven : {true, false})
    for (const double width : {0.09, 0.13}) {
      HoofPart hoof;
      hoof.cloven = cloven;
      hoof.width = width;
      hoof.length = 0.14;
      hoof.height = 0.09;
      const Box box = box_of(build_with({make("left_fore_hoof", {}, hoof)}), "hoof_fore_left");
      INFO(cloven, " ", width);
      CHECK(box.size().y == doctest::Approx(width).epsilon(0.04));
      CHECK(box.size().x == doctest::Approx(0.14).epsilon(0.06));
      CHECK(box.upper.z == doctest::Approx(0.09).epsilon(0.15));
      CHECK(std::abs(box.lower.z) < 0.002);
    }
}

TEST_CASE("a cloven hoof has a cleft, a single one has none") {
  for (const bool cloven : {true, false}) {
    HoofPart hoof;
    hoof.cloven = cloven;
    hoof.cleft = 0.02;
    const Rig rig = build_with({make("left_fore_hoof", {}, hoof)});
    double nearest = 1;  // of the hoof's lower half to its middle plane
    for (const vec3& p : rig.surface.rest)
      if (p.z < 0.03f && p.y > 0) nearest = std::min(nearest, std::abs(static_cast<double>(p.y) - 0.12));
    if (cloven)
      CHECK(nearest == doctest::Approx(0.01).epsilon(0.1));
    else
      CHECK(nearest < 0.005);
  }
}

TEST_CASE("an ear is as long and wide as asked and points where it is set") {
  EarPart ear;
  ear.length = 0.2, ear.width = 0.09;
  const dvec3 root(0.2, 0.12, 0.45);
  const auto tip = [&](const EarPart& e) {
    const Box b = box_of(build_with({make("ear_l", {0, 0, 0}, e)}), "ear_l");
    return b;
  };
  ear.set_deg = 0;
  const Box level = tip(ear);
  ear.set_deg = 80;
  const Box upright = tip(ear);
  CHECK(level.size().y == doctest::Approx(0.2).epsilon(0.15));
  CHECK(level.size().z == doctest::Approx(0.09).epsilon(0.1));
  CHECK(upright.upper.z - level.upper.z > 0.1);
  ear.set_deg = 0;
  ear.width = 0.06;
  CHECK(tip(ear).size().z == doctest::Approx(0.06).epsilon(0.12));
}

TEST_CASE("an eye keeps to the skin, shows a ball of about its length, and stands out as far as asked") {
  EyePart eye;
  eye.length = 0.05, eye.height = 0.034, eye.bulge = 0.012, eye.slant_deg = 0, eye.brow = 0;
  const Rig rig = build_with({make("head", {-0.05, 0.16, 0}, eye)});  // 4 cm off the skin: slides onto it
  const Box ball = box_of(rig, "eye_l"), lids = box_of(rig, "eyelid_l");
  CHECK(ball.size().x == doctest::Approx(0.05).epsilon(0.12));
  CHECK(ball.size().z == doctest::Approx(0.034).epsilon(0.15));
  CHECK(lids.upper.y == doctest::Approx(0.12 + 0.012).epsilon(0.03));
  CHECK(ball.upper.y > 0.12);
}

TEST_CASE("a nostril is a hole of the depth asked") {
  NostrilPart nostril;
  nostril.depth = 0.03;
  nostril.flare = 0;
  const dvec3 at(0.32, 0.04, 0.45);
  const Rig whole = build_with({}), cut = build_with({make("head", {0.12, 0.04, 0}, nostril)});
  double before = 1e9, after = 1e9;  // least distance from the trunk's axis end, near the hole
  const auto least = [&](const Rig& rig, double& out) {
    for (const vec3& p : rig.surface.rest)
      if (p.x > 0.2f && p.y > 0.01f && std::abs(p.z - 0.45f) < 0.04f)
        out = std::min(out, glm::length(dvec3(p) - dvec3(0.2, 0, 0.45)));
  };
  least(whole, before);
  least(cut, after);
  CHECK(before - after > 0.015);
  CHECK(before - after < 0.04);
  CHECK(at.x > 0);
}

TEST_CASE("parts that name no joint, or find no skin, are refused with their name") {
  CHECK_THROWS_WITH_AS(build_with({make("nobody", {}, EyePart{})}), doctest::Contains("'nobody'"), InputError);
  CHECK_THROWS_WITH_AS(build_with({make("head", {1, 0.5, 0}, EyePart{})}), doctest::Contains("finds no skin"), InputError);
}
