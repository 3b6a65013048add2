// Leg inverse kinematics against closed forms; every clip that ships, on the skinned cow.
#include "rigs/motion.h"

#include <doctest/doctest.h>

#include <fstream>
#include <set>

#include "generator/core/error.h"
#include "rigs/leg_ik.h"
#include "rigs/pose.h"
#include "scenes/motion_file.h"
#include "scenes/scene.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

const Species& cow() {
  static const Species species = read_species("cow", NnopcsNormalization::box, ".");
  return species;
}

// Two bones that hang straight down.
constexpr double upper = 0.5, lower = 0.4;
dvec3 two_bones(double bend) {
  return dvec3(0, 0, -upper) + about_y(bend) * dvec3(0, 0, -lower);
}

const Range any{-pi, pi}, forwards{0, 2.8};

std::string refusal(const std::string& text) {
  const fs::path folder = fs::temp_directory_path() / "moomill_motion_test";
  fs::remove_all(folder);
  fs::create_directories(folder);
  std::ofstream(folder / "hop.toml") << text;
  std::string message;
  try {
    const Species& s = cow();
    LegSpec leg{"left_fore_scapula", "left_fore_shoulder", "left_fore_elbow", "left_fore_carpus",
                "left_fore_fetlock", "left_fore_hoof"};
    build_motion("cow.toml", {leg}, read_motion(folder), s.rig, s.neutral, s.limits);
  } catch (const InputError& e) {
    message = e.what();
  }
  fs::remove_all(folder);
  return message;
}

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace

TEST_CASE("leg IK agrees with the law of cosines and brings the end to the target") {
  for (double x = -0.5; x <= 0.5; x += 0.1)
    for (double y = -0.2; y <= 0.2; y += 0.1)
      for (double z = -0.65; z <= -0.3; z += 0.07) {
        const dvec3 target(x, y, z);
        const double reach = glm::length(target);
        if (reach > upper + lower - 1e-3 || reach < 0.15) continue;
        const LegAngles a = solve_leg(two_bones, target, any, any, forwards, 0.3);
        const double inner = std::acos((upper * upper + lower * lower - reach * reach) / (2 * upper * lower));
        CHECK(a.bend == doctest::Approx(pi - inner).epsilon(1e-6));
        CHECK(a.miss < 1e-9);
        const dvec3 end = about_y(a.pitch) * about_x(a.roll) * two_bones(a.bend);
        CHECK(glm::length(end - target) < 1e-9);
      }
}

TEST_CASE("leg IK out of reach stretches towards the target, within the ranges, without not-a-number") {
  const LegAngles far = solve_leg(two_bones, {0.9, 0, -0.9}, any, any, forwards, 0.3);
  CHECK(far.bend == doctest::Approx(0).epsilon(1e-9));
  CHECK(far.pitch == doctest::Approx(-45 * degrees));  // forward is a negative pitch
  CHECK(far.miss == doctest::Approx(std::sqrt(2.0) * 0.9 - upper - lower));
  const LegAngles near = solve_leg(two_bones, {0, 0, -0.01}, any, any, forwards, 0.3);
  CHECK(near.bend == doctest::Approx(2.8));
  const Range narrow{-0.2, 0.1};
  for (const dvec3& target : {dvec3(1, 1, 1), dvec3(0, 5, 0), dvec3(0), dvec3(-3, 0.5, 0.1), dvec3(1e300, 0, 0)}) {
    const LegAngles a = solve_leg(two_bones, target, narrow, narrow, narrow, 0.0);
    for (const double angle : {a.pitch, a.roll, a.bend}) {
      CHECK(angle >= -0.2);
      CHECK(angle <= 0.1);
    }
  }
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const LegAngles lost = solve_leg(two_bones, {nan, 0, 0}, narrow, narrow, narrow, 0.0);
  CHECK(std::isfinite(lost.pitch + lost.roll + lost.bend));
}

TEST_CASE("the cow moves in all the ways that are asked of her, and every loop closes") {
  std::set<std::string> names;
  for (const Clip& clip : cow().rig.clips) names.insert(clip.name);
  CHECK(names == std::set<std::string>{"drink", "flies", "graze", "idle", "lie", "look_around", "rest", "scratch", "stand",
                                       "trot", "walk"});
  REQUIRE(cow().clip_plans.size() == names.size());
  const int top = 0;
  for (std::size_t c = 0; c < cow().rig.clips.size(); ++c) {
    const Clip& clip = cow().rig.clips[c];
    INFO(clip.name);
    if (!cow().clip_plans[c].loops) continue;
    const Pose first = sample_clip(cow().rig, clip, 0), last = sample_clip(cow().rig, clip, clip.duration);
    for (std::size_t j = 0; j < cow().rig.nodes.size(); ++j) {
      const LocalTransform a = local_transform(cow().rig, first, static_cast<int>(j)),
                           b = local_transform(cow().rig, last, static_cast<int>(j));
      CHECK(std::abs(glm::dot(a.rotation, b.rotation)) == doctest::Approx(1).epsilon(1e-9));
      const dvec3 way = b.translation - a.translation;
      CHECK(std::abs(way.y) + std::abs(way.z) < 1e-9);
      if (static_cast<int>(j) != top) CHECK(std::abs(way.x) < 1e-9);
    }
  }
}

TEST_CASE("the head of a grazing and of a drinking cow is down to within 5 cm of the ground, and not in it") {
  const Rig& rig = cow().rig;
  for (const std::string name : {"graze", "drink"}) {
    const Clip& clip = rig.clips[rig.find_clip(name)];
    for (const double share : {0.3, 0.45, 0.6, 0.75}) {
      const PosedSurface posed =
          skin(rig, bone_matrices(rig, world_transforms(rig, sample_clip(rig, clip, share * clip.duration))), {},
               cow().skinning, dvec3(0));
      const int poll = rig.find_node("poll");
      float low = 10;
      for (std::size_t v = 0; v < posed.positions.size(); ++v)
        for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
          if (rig.bones[rig.influences[i].bone].node == poll && rig.influences[i].weight > 0.9f)
            low = std::min(low, posed.positions[v].z);
      INFO(name, " ", share);
      CHECK(low >= 0);
      CHECK(low < 0.05f);
    }
  }
}

TEST_CASE("a motion is built alike every time") {
  const Species& s = cow();
  std::vector<LegSpec> legs = {
      {"left_fore_scapula", "left_fore_shoulder", "left_fore_elbow", "left_fore_carpus", "left_fore_fetlock",
       "left_fore_hoof"},
      {"", "left_hind_hip", "left_hind_stifle", "left_hind_hock", "left_hind_fetlock", "left_hind_hoof", -0.9}};
  std::vector<ClipSpec> walk;
  for (ClipSpec& c : read_motion(data_root() / "rigs/cow/motion"))
    if (c.name == "walk") walk.push_back(c);
  REQUIRE(walk.size() == 1);
  const Motion a = build_motion("cow.toml", legs, walk, s.rig, s.neutral, s.limits),
               b = build_motion("cow.toml", legs, walk, s.rig, s.neutral, s.limits);
  const Clip& shipped = s.rig.clips[s.rig.find_clip("walk")];
  REQUIRE(a.clips[0].channels.size() == b.clips[0].channels.size());
  for (std::size_t i = 0; i < a.clips[0].channels.size(); ++i) {
    CHECK(a.clips[0].channels[i].values == b.clips[0].channels[i].values);
    CHECK(a.clips[0].channels[i].values == shipped.channels[i].values);
  }
}

TEST_CASE("mistakes in motion files are told with the place and the mend") {
  CHECK(contains(refusal("duration_s = 1\nspeed = 2\n"), "hop.toml:2: unknown key 'speed'"));
  CHECK(contains(refusal("keys = 4\n"), "duration_s"));
  CHECK(contains(refusal("duration_s = 1\nwaves = [{ joint = \"wing\" }]\n"), "names the joint 'wing'"));
  CHECK(contains(refusal("duration_s = 1\nsteps = [{ foot = \"paw\", times = [0, 1], to = [0, 0] }]\n"),
                 "names the foot 'paw', which is no leg's; known are left_fore_hoof, right_fore_hoof"));
  CHECK(contains(refusal("duration_s = 1\nwaves = [{ joint = \"left_fore_elbow\", amplitude_deg = [0, 9, 0] }]\n"),
                 "turns 'left_fore_elbow', but inverse kinematics does"));
  CHECK(contains(refusal("duration_s = 1\ntracks = [{ joint = \"poll\", times = [0, 1], rotation_deg = [0, 1] }]\n"),
                 "three numbers for each of the 2 times"));
  CHECK(contains(refusal("duration_s = 1\n[gait]\nstride = 1\nduty = 0.6\n[[gait.legs]]\nfeet = [\"left_fore_hoof\"]\n"
                         "phases = [0, 1]\n"),
                 "one number for each of the 1 feet, not 2"));
}
