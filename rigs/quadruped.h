#pragma once
// Builds a four-legged animal from numbers: joints and solids around them. No species is named here: what makes
// a cow of it is in rigs/cow/cow.toml, read by scenes/quadruped_file.cpp.
//
// The animal is bilaterally symmetric about y = 0. The spec names the midline and the left side (y > 0); whatever has
// `mirror` set gets a right-hand twin, with "left" in its names replaced by "right" and a trailing "_l" by "_r".
#include <optional>
#include <string>
#include <vector>

#include "rigs/motion.h"
#include "rigs/rig.h"

namespace moomill {

struct QuadrupedJoint {
  std::string name;
  std::string parent;  // empty for the root
  dvec3 at{0};         // metres, model space (Z up, facing +X) in the neutral pose
  bool mirror = false;
};

// One cross-section of a solid: a superellipse |s / side|^power + |u / up|^power = 1 around `at`.
struct SolidSection {
  dvec3 at{0};                              // metres
  double side = 0.1, up = 0.1, down = 0.1;  // metres: half widths across, towards and away from Solid::up
  double power = 2;                         // 2 is an ellipse, more is boxier
  std::string joint;                        // what skin here moves with; empty: as the section before
  std::string part;                         // body part here; empty: as the section before
};

// A tube through its sections (smoothly interpolated), closed by round caps. With one section: an ellipsoid.
struct Solid {
  enum class Kind {
    add,    // joined to the solids before it
    carve,  // taken away from the solids before it
    paint,  // no shape of its own: names the part of the surface inside it
  };
  std::string name;  // for messages
  Kind kind = Kind::add;
  double blend = 0.03;                      // metres: radius of the fillet where it meets the solids before it
  double detail = 1;                        // triangle edges here are this times the target edge
  dvec3 up{0, 0, 1};                        // which way `up` of its sections points (made square to the tube's axis)
  double cap_start = 0.02, cap_end = 0.02;  // metres the end caps reach beyond the first and last section
  bool mirror = false;
  std::vector<SolidSection> sections;
};

struct QuadrupedSpec {
  std::string source;          // file, for messages
  double target_edge = 0.024;  // metres; what triangle edges are like where `detail` is 1
  double grid = 0.007;         // metres; resolves the thinnest part, whatever the target edge
  double gutter = 0.004;       // free border around UV charts, share of the atlas' side
  int handles = 0;             // loops of the body one can reach through (its genus)
  double scale = 1;  // of every length, once the animal is built: as if all numbers here were multiplied
  std::vector<QuadrupedJoint> joints;  // in any order
  std::vector<Solid> solids;
  std::vector<LegSpec> legs;  // for the clips, see motion.h
};

// A closed, two-manifold, left/right symmetric skinned mesh with UV atlas and parts. The same bytes for any
// number of threads. Throws InputError where the spec contradicts itself (quadruped_check.h lists how).
Rig build_quadruped(const QuadrupedSpec& spec);

}  // namespace moomill
