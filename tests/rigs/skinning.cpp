#include <doctest/doctest.h>

#include "rigs/pose.h"

using namespace moomill;

TEST_CASE("Forward kinematics multiplies parents before children") {
  Rig rig;
  rig.nodes = {{.name = "a", .parent = -1, .translation = {1, 0, 0}},
               {.name = "b", .parent = 0, .translation = {0, 2, 0}, .rotation = glm::angleAxis(pi / 2, dvec3(0, 0, 1))},
               {.name = "c", .parent = 1, .translation = {3, 0, 0}}};
  const auto world = world_transforms(rig, bind_pose(rig));
  CHECK(glm::length(dvec3(world[2][3]) - dvec3(1, 5, 0)) < 1e-15);
}
