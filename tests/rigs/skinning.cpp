#include <doctest/doctest.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <chrono>
#include <random>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "rigs/species.h"
#include "tests/rigs/fixtures.h"

using namespace moomill;

namespace {

dquat about(const dvec3& axis, double angle) {
  return glm::angleAxis(angle, glm::normalize(axis));
}

PosedSurface pose_skin(const Rig& rig, const Pose& pose, SkinningMethod method, const dvec3& origin = dvec3(0)) {
  return skin(rig, bone_matrices(rig, world_transforms(rig, pose)), pose.morph_weights, method, origin);
}

Pose twisted(const Rig& rig, double angle) {
  Pose pose = bind_pose(rig);
  pose.local[1] = LocalTransform{.translation = {0, 0, 1}, .rotation = about({0, 0, 1}, angle)};
  return pose;
}

// Linear blending as the formula says, vertex by vertex, nothing shared with the library.
std::vector<dvec3> plain_linear(const Rig& rig, const std::vector<dmat4>& bones) {
  std::vector<dvec3> out;
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
    dvec4 sum(0);
    double weights = 0;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i) {
      sum += static_cast<double>(rig.influences[i].weight) *
             (bones[rig.influences[i].bone] * dvec4(dvec3(rig.surface.rest[v]), 1));
      weights += rig.influences[i].weight;
    }
    out.push_back(dvec3(sum) / weights);
  }
  return out;
}

double ring_radius(const PosedSurface& posed, int ring, int sides = 16) {
  double least = 1e9;
  for (int s = 0; s < sides; ++s) {
    const vec3& p = posed.positions[ring * sides + s];
    least = std::min<double>(least, std::hypot(p.x, p.y));
  }
  return least;
}

}  // namespace

TEST_CASE("Forward kinematics multiplies parents before children, under the placement") {
  Rig rig;
  rig.nodes = {{.name = "a", .parent = -1, .translation = {1, 0, 0}},
               {.name = "b", .parent = 0, .translation = {0, 2, 0}, .rotation = about({0, 0, 1}, pi / 2)},
               {.name = "c", .parent = 1, .translation = {3, 0, 0}, .scale = {2, 2, 2}}};
  Pose pose = bind_pose(rig);
  CHECK(glm::length(dvec3(world_transforms(rig, pose)[2][3]) - dvec3(1, 5, 0)) < 1e-15);
  CHECK(glm::length(transform_point(world_transforms(rig, pose)[2], {0, 0, 1}) - dvec3(1, 5, 2)) < 1e-15);
  pose.placement = compose({.translation = {10, 0, 0}, .rotation = about({0, 0, 1}, pi)});
  CHECK(glm::length(dvec3(world_transforms(rig, pose)[2][3]) - dvec3(9, -5, 0)) < 1e-14);
  pose.local.pop_back();
  CHECK_THROWS_AS(world_transforms(rig, pose), std::logic_error);
}

TEST_CASE("Matrices come apart and together again, mirrored and flat ones stay finite") {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(-1, 1);
  for (int i = 0; i < 200; ++i) {
    LocalTransform local{.translation = {u(random), u(random), u(random)},
                         .rotation = about({u(random), u(random), 1.1 + u(random)}, 3 * u(random)),
                         .scale = {1.1 + u(random), 1.1 + u(random), 1.1 + u(random)}};
    if (i % 2) local.scale.y *= -1;
    const dmat4 m = compose(local), again = compose(decompose(m));
    for (int c = 0; c < 4; ++c) CHECK(glm::length(m[c] - again[c]) < 1e-13);
  }
  for (const dmat4& flat : {dmat4(0.0), dmat4(dvec4(1, 0, 0, 0), dvec4(1, 0, 0, 0), dvec4(0), dvec4(0, 0, 0, 1))}) {
    const LocalTransform local = decompose(flat);
    CHECK(std::abs(glm::length(local.rotation) - 1) < 1e-12);
    CHECK(all_finite(local.scale));
  }
}

TEST_CASE("Skinning the bind pose gives the rest positions and normals, by both methods") {
  const Rig rig = fixtures::tube();
  for (const auto method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    const PosedSurface posed = pose_skin(rig, bind_pose(rig), method);
    for (std::size_t i = 0; i < posed.positions.size(); ++i) {
      CHECK(glm::length(posed.positions[i] - rig.surface.rest[i]) < 1e-6f);
      CHECK(glm::length(posed.normals[i] - rig.surface.normals[i]) < 1e-6f);
    }
  }
}

TEST_CASE("Linear blending agrees with the formula, also far from the origin") {
  const Rig rig = fixtures::tube();
  Pose pose = twisted(rig, 1.1);
  pose.local[0] = LocalTransform{.translation = {0.3, -2, 1}, .rotation = about({1, 2, 3}, 2), .scale = {1, 1.4, 0.8}};
  pose.placement = compose({.translation = {123456.5, -98765.25, 1000}});
  const dvec3 origin(123456, -98766, 1001);
  const auto bones = bone_matrices(rig, world_transforms(rig, pose));
  const PosedSurface posed = skin(rig, bones, {}, SkinningMethod::linear_blend, origin);
  const std::vector<dvec3> expected = plain_linear(rig, bones);
  for (std::size_t i = 0; i < expected.size(); ++i)
    CHECK(glm::length(dvec3(posed.positions[i]) + origin - expected[i]) < 1e-6);
}

TEST_CASE("One bone per vertex: dual quaternions move exactly as matrices do, stretched or not") {
  Rig rig = fixtures::tube();
  for (std::uint32_t v = 0; v < rig.surface.rest.size(); ++v) rig.influence_begin[v] = v;
  rig.influence_begin.back() = static_cast<std::uint32_t>(rig.surface.rest.size());
  rig.influences.clear();
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) rig.influences.push_back({v % 3 == 0 ? 1u : 0u, 1});
  for (const dvec3& scale : {dvec3(1), dvec3(1.5, 0.7, 2), dvec3(-1, 1, 1), dvec3(1, 1, 0)}) {
    Pose pose = twisted(rig, 2.5);
    pose.local[1]->scale = scale;
    pose.local[0] = LocalTransform{.translation = {5, 6, 7}, .rotation = about({1, -2, 0.5}, 3)};
    const PosedSurface a = pose_skin(rig, pose, SkinningMethod::linear_blend);
    const PosedSurface b = pose_skin(rig, pose, SkinningMethod::dual_quaternion);
    for (std::size_t i = 0; i < a.positions.size(); ++i) {
      CHECK(glm::length(a.positions[i] - b.positions[i]) < 2e-6f);
      if (scale.z != 0) CHECK(glm::length(a.normals[i] - b.normals[i]) < 1e-5f);
    }
  }
}

TEST_CASE("A twist by 180 degrees collapses the tube with linear blending and keeps its radius with dual quaternions") {
  const Rig rig = fixtures::tube();
  const Pose pose = twisted(rig, pi * (1 - 1e-9));
  const int middle = 10;  // z = 1: both weights are one half
  CHECK(ring_radius(pose_skin(rig, pose, SkinningMethod::linear_blend), middle) < 1e-6);
  const PosedSurface smooth = pose_skin(rig, pose, SkinningMethod::dual_quaternion);
  for (int ring = 0; ring < 21; ++ring) CHECK(ring_radius(smooth, ring) == doctest::Approx(0.2).epsilon(1e-5));
  // And half way it has turned by half the angle.
  CHECK(glm::length(smooth.positions[middle * 16] - vec3(0, 0.2f, 1)) < 1e-5f);
}

TEST_CASE("Antipodal quaternions: a full turn of one bone is no turn") {
  const Rig rig = fixtures::tube();
  Pose pose = twisted(rig, 0);
  pose.local[1]->rotation = dquat(-1, 0, 0, 0);
  const PosedSurface posed = pose_skin(rig, pose, SkinningMethod::dual_quaternion);
  for (std::size_t i = 0; i < posed.positions.size(); ++i)
    CHECK(glm::length(posed.positions[i] - rig.surface.rest[i]) < 1e-6f);
}

TEST_CASE("A scaled bone swells about its joint, and normals follow the inverse transpose") {
  const Rig rig = fixtures::tube();
  Pose pose = twisted(rig, 0);
  pose.local[1]->scale = {2, 1, 1};
  for (const auto method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    const PosedSurface posed = pose_skin(rig, pose, method);
    for (int s = 0; s < 16; ++s) {
      const std::size_t i = 20 * 16 + s;  // the top ring, wholly on the upper bone
      const vec3 rest = rig.surface.rest[i];
      CHECK(glm::length(posed.positions[i] - vec3(2 * rest.x, rest.y, rest.z)) < 1e-6f);
      const vec3 n = rig.surface.normals[i];
      CHECK(glm::length(posed.normals[i] - glm::normalize(vec3(n.x / 2, n.y, n.z))) < 1e-6f);
    }
  }
}

TEST_CASE("Extreme poses stay finite, and normals stay unit") {
  const Rig rig = fixtures::tube();
  std::mt19937 random(7);
  std::uniform_real_distribution<double> u(-1, 1);
  for (int i = 0; i < 100; ++i) {
    Pose pose = bind_pose(rig);
    for (int node = 0; node < 2; ++node) {
      LocalTransform local{.translation = 1e3 * dvec3(u(random), u(random), u(random)),
                           .rotation = about({u(random), u(random), u(random) + 1e-3}, 10 * u(random)),
                           .scale = dvec3(u(random), u(random), u(random))};
      if (i % 3 == 0) local.scale = dvec3(0);
      if (i % 3 == 1) local.scale.y = 0;
      if (i % 7 == 0) local.scale = dvec3(1e-12, 1e12, 1);
      pose.local[node] = local;
    }
    for (const auto method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
      const PosedSurface posed = pose_skin(rig, pose, method);
      bool finite = true, unit = true;
      for (const vec3& p : posed.positions) finite &= all_finite(p);
      for (const vec3& n : posed.normals) unit &= std::abs(glm::length(n) - 1) < 1e-4f;
      CHECK(finite);
      CHECK(unit);
    }
  }
}

TEST_CASE("The number of threads changes no bit") {
  const Rig rig = fixtures::tube(1501, 16);
  Pose pose = twisted(rig, 1.234);
  pose.local[1]->scale = {1.1, 0.9, 1.3};
  for (const auto method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    std::vector<PosedSurface> results;
    for (const int threads : {1, 2, 7}) {
      tbb::task_arena arena(threads);
      arena.execute([&] { results.push_back(pose_skin(rig, pose, method, {0.1, 0.2, 0.3})); });
    }
    for (std::size_t r = 1; r < results.size(); ++r) {
      CHECK(std::memcmp(results[0].positions.data(), results[r].positions.data(),
                        results[0].positions.size() * sizeof(vec3)) == 0);
      CHECK(std::memcmp(results[0].normals.data(), results[r].normals.data(),
                        results[0].normals.size() * sizeof(vec3)) == 0);
    }
  }
}

TEST_CASE("Skinning 100,000 vertices with four influences takes milliseconds") {
  Rig rig = fixtures::tube(6251, 16);
  rig.influences.clear();
  for (std::uint32_t v = 0; v <= rig.surface.rest.size(); ++v) rig.influence_begin[v] = 4 * v;
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v)
    for (std::uint32_t k = 0; k < 4; ++k) rig.influences.push_back({(static_cast<std::uint32_t>(v) + k) % 2, 0.25f});
  const Pose pose = twisted(rig, 0.5);
  for (const auto method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    double best = 1e9;
    tbb::task_arena arena(1);
    arena.execute([&] {
      for (int i = 0; i < 10; ++i) {
        const auto start = std::chrono::steady_clock::now();
        pose_skin(rig, pose, method);
        best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
      }
    });
    MESSAGE(rig.surface.rest.size(), " vertices x 4 influences, one thread, ",
            std::string(method == SkinningMethod::linear_blend ? "linear blend" : "dual quaternions"), ": ", 1e3 * best,
            " ms");
    CHECK(best < 1);  // generous: the machine may be busy and the build sanitised
  }
}

TEST_CASE("Keypoints ride on joints and on the surface") {
  Species species;
  species.rig = fixtures::tube();
  species.neutral = bind_pose(species.rig);
  species.keypoints = {{.name = "end", .anchor = JointAnchor{1, {0, 0, 2}}},
                       {.name = "skin", .anchor = SurfaceAnchor{0, {0.25, 0.5}}}};
  const auto neutral = world_transforms(species.rig, species.neutral);
  Pose pose = bind_pose(species.rig);
  pose.local[1] = LocalTransform{.translation = {0, 0, 1}, .rotation = about({0, 1, 0}, pi / 2)};
  pose.placement = compose({.translation = {10, 0, 0}});
  const auto world = world_transforms(species.rig, pose);
  const PosedSurface posed =
      skin(species.rig, bone_matrices(species.rig, world), {}, SkinningMethod::linear_blend, {10, 1, 0});
  const auto points = keypoint_positions(species, world, neutral, posed);
  CHECK(glm::length(points[0] - dvec3(11, 0, 1)) < 1e-12);
  const uvec3 t = species.rig.surface.triangles[0];
  const auto& rest = species.rig.surface.rest;
  const dvec3 expected =
      0.25 * dvec3(rest[t[0]]) + 0.25 * dvec3(rest[t[1]]) + 0.5 * dvec3(rest[t[2]]) + dvec3(10, 0, 0);
  CHECK(glm::length(points[1] - expected) < 1e-6);
}

TEST_CASE("Limits turn joints about the axes of the model, whatever way joints point") {
  Species species;
  species.rig = fixtures::tube();
  species.rig.nodes[0].rotation = about({1, 1, 0}, 1);  // an odd frame for the parent
  species.neutral = bind_pose(species.rig);
  species.limits = {{.node = 1, .lower_deg = {0, -30, 0}, .upper_deg = {0, 60, 0}}};
  const auto direction = [&](double u) {
    const Pose pose = sample_within_limits(species, {0.5, u, 0.5});
    const dmat4 now = world_transforms(species.rig, pose)[1], was = world_transforms(species.rig, species.neutral)[1];
    return dmat3(now) * glm::transpose(dmat3(was));  // rotation from the neutral pose, in model space
  };
  for (const double u : {0.0, 1.0 / 3, 0.9}) {
    const dmat3 expected(glm::mat3_cast(about({0, 1, 0}, (-30 + 90 * u) * degrees)));
    for (int c = 0; c < 3; ++c) CHECK(glm::length(direction(u)[c] - expected[c]) < 1e-12);
  }
  const Pose again = sample_within_limits(species, {0.5, 0.25, 0.5});
  CHECK(again.local[1]->rotation == sample_within_limits(species, {0.5, 0.25, 0.5}).local[1]->rotation);
}
