#include "generator/core/surface.h"

#include <doctest/doctest.h>

using namespace moomill;

TEST_CASE("NNOPCS spans the unit interval over the neutral box and multiplies back to metres") {
  Surface s;
  s.rest = {{-1, 0, 0}, {1, 0.5f, 0}, {0, 0, 2}, {9, 9, 9}};  // the last vertex belongs to no triangle
  s.triangles = {{0, 1, 2}};
  for (auto kind : {NnopcsNormalization::box, NnopcsNormalization::diagonal}) {
    bake_nnopcs(s, s.rest, kind);
    CHECK(s.neutral_box.upper.x == 1.0);
    for (int i = 0; i < 3; ++i) {
      const dvec3 back = nnopcs_to_metres(s, dvec3(s.nnopcs[i]));
      CHECK(glm::length(back - dvec3(s.rest[i])) < 1e-6);
    }
  }
  bake_nnopcs(s, s.rest, NnopcsNormalization::box);
  CHECK(s.nnopcs[0] == vec3(0, 0, 0));
  CHECK(s.nnopcs[1] == vec3(1, 1, 0));
  CHECK(s.nnopcs[2] == vec3(0.5, 0, 1));
}
