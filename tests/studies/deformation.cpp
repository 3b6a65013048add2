// The deformation measures on tubes bent and twisted by known angles.
#include "validate/studies/deformation.h"

#include <doctest/doctest.h>

#include <glm/gtc/matrix_transform.hpp>

using namespace moomill;

namespace {

constexpr int around = 48, along = 80;
constexpr double radius = 0.05, length = 1;

// A closed tube along z with a joint at its root and one in its middle; weights pass over linearly from 0.3 to 0.7.
Rig tube() {
  Rig rig;
  Node root, tip;
  root.name = "root";
  tip.name = "tip";
  tip.parent = 0;
  tip.translation = {0, 0, 0.5 * length};
  rig.nodes = {root, tip};
  Bone first, second;
  second.node = 1;
  second.inverse_bind[3] = dvec4(0, 0, -0.5 * length, 1);
  rig.bones = {first, second};
  Surface& s = rig.surface;
  const auto add = [&](const dvec3& p, const dvec3& n) {
    s.rest.emplace_back(p);
    s.normals.emplace_back(n);
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    const float w = static_cast<float>(std::clamp((p.z / length - 0.3) / 0.4, 0.0, 1.0));
    if (w < 1) rig.influences.push_back({0, 1 - w});
    if (w > 0) rig.influences.push_back({1, w});
  };
  for (int k = 0; k <= along; ++k)
    for (int i = 0; i < around; ++i) {
      const double a = 2 * pi * i / around;
      const dvec3 out(std::cos(a), std::sin(a), 0);
      add(radius * out + dvec3(0, 0, length * k / along), out);
    }
  const auto at = [](int k, int i) { return static_cast<std::uint32_t>(k * around + i % around); };
  for (int k = 0; k < along; ++k)
    for (int i = 0; i < around; ++i) {
      s.triangles.emplace_back(at(k, i), at(k, i + 1), at(k + 1, i + 1));
      s.triangles.emplace_back(at(k, i), at(k + 1, i + 1), at(k + 1, i));
    }
  const std::uint32_t bottom = static_cast<std::uint32_t>(s.rest.size());
  add({0, 0, 0}, {0, 0, -1});
  add({0, 0, length}, {0, 0, 1});
  for (int i = 0; i < around; ++i) {
    s.triangles.emplace_back(bottom, at(0, i + 1), at(0, i));
    s.triangles.emplace_back(bottom + 1, at(along, i), at(along, i + 1));
  }
  rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  s.parts.assign(s.triangles.size(), 0);
  s.materials.assign(s.triangles.size(), 0);
  rig.part_names = {"tube"};
  return rig;
}

Deformation measure(const Rig& rig, const Pose& pose, SkinningMethod method) {
  const DeformationReference reference = deformation_reference(rig);
  REQUIRE(reference.closed);
  REQUIRE(reference.rings.size() >= 3);
  const std::vector<dmat4> bones = bone_matrices(rig, world_transforms(rig, pose));
  return measure_deformation(rig, reference, bones, skin(rig, bones, {}, method, dvec3(0)));
}

Pose turned(const Rig& rig, const dvec3& axis, double angle_deg) {
  Pose pose = bind_pose(rig);
  pose.local[1] = LocalTransform{rig.nodes[1].translation, glm::angleAxis(angle_deg * degrees, axis), dvec3(1)};
  return pose;
}

double tube_volume() {
  return 0.5 * around * std::sin(2 * pi / around) * radius * radius * length;  // of the polygonal prism
}

}  // namespace

TEST_CASE("A rigid motion leaves volume, rings and orientation as they were") {
  const Rig rig = tube();
  Pose pose = bind_pose(rig);
  pose.placement = glm::translate(dmat4(1.0), dvec3(3, -2, 1)) * glm::rotate(dmat4(1.0), 1.1, glm::normalize(dvec3(1, 2, 3)));
  for (const SkinningMethod method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    const Deformation d = measure(rig, pose, method);
    CHECK(d.volume == doctest::Approx(tube_volume()).epsilon(1e-5));
    CHECK(d.inverted == 0);
    CHECK(d.crushed == 0);
    CHECK(d.finite);
    for (const double r : d.rings) CHECK(r == doctest::Approx(1).epsilon(1e-5));
  }
}

TEST_CASE("A twist leaves linear blending cos^2 of half of it at the joint, dual quaternions all") {
  const Rig rig = tube();
  for (const double angle : {60.0, 120.0, 175.0}) {
    const Deformation linear = measure(rig, turned(rig, {0, 0, 1}, angle), SkinningMethod::linear_blend);
    const Deformation dual = measure(rig, turned(rig, {0, 0, 1}, angle), SkinningMethod::dual_quaternion);
    const double half = std::cos(0.5 * angle * degrees);
    CHECK(*std::min_element(linear.rings.begin(), linear.rings.end()) == doctest::Approx(half * half).epsilon(2e-3));
    CHECK(*std::min_element(dual.rings.begin(), dual.rings.end()) > 0.995);
    // Along the blend, area is 1 - 4 w (1 - w) sin^2(angle / 2), on average 1 - 2/3 sin^2 over 0.4 of the length.
    const double lost = 0.4 * 2.0 / 3.0 * std::pow(std::sin(0.5 * angle * degrees), 2);
    CHECK(1 - linear.volume / tube_volume() == doctest::Approx(lost).epsilon(0.02));
    CHECK(dual.volume / tube_volume() == doctest::Approx(1).epsilon(0.01));
    CHECK(dual.inverted == 0);
  }
}

TEST_CASE("A gentle bend turns no triangle; one folded into itself does") {
  const Rig rig = tube();
  CHECK(measure(rig, turned(rig, {1, 0, 0}, 40), SkinningMethod::linear_blend).inverted == 0);
  Rig tight = tube();  // no room to bend in: weights change over 2 cm, a tube 10 cm wide
  for (std::size_t v = 0; v < tight.surface.rest.size(); ++v) {
    const float w = std::clamp((tight.surface.rest[v].z - 0.49f) / 0.02f, 0.0f, 1.0f);
    if (v == 0) tight.influences.clear();
    tight.influence_begin[v] = static_cast<std::uint32_t>(tight.influences.size());
    if (w < 1) tight.influences.push_back({0, 1 - w});
    if (w > 0) tight.influences.push_back({1, w});
  }
  tight.influence_begin.back() = static_cast<std::uint32_t>(tight.influences.size());
  CHECK(measure(tight, turned(tight, {1, 0, 0}, 100), SkinningMethod::linear_blend).inverted > 0.002);
}

TEST_CASE("The study holds its bounds against the species' own method and tells an open surface") {
  Species species;
  species.name = "tube";
  species.rig = tube();
  species.neutral = bind_pose(species.rig);
  species.skinning = SkinningMethod::dual_quaternion;
  species.limits = {{1, {0, 0, -60}, {0, 0, 60}}};
  const std::vector<Pose> poses{turned(species.rig, {0, 0, 1}, 100)};
  CHECK(study_deformation(species, poses, 1).holds());
  species.skinning = SkinningMethod::linear_blend;  // its ring loses more than half
  CHECK_FALSE(study_deformation(species, poses, 1).holds());
  species.rig.surface.triangles.pop_back();
  species.rig.surface.parts.pop_back();
  species.rig.surface.materials.pop_back();
  CHECK(study_deformation(species, poses, 1).table.find("open") != std::string::npos);
}
