#pragma once
// Builds a four-legged animal from numbers: joints, solids around them, clips. No species is named here: what makes
// a cow of it is in rigs/cow/cow.toml, read by scenes/quadruped_file.cpp.
//
// The animal is bilaterally symmetric about y = 0. The spec names the midline and the left side (y > 0); whatever has
// `mirror` set gets a right-hand twin, with "left" in its names replaced by "right" and a trailing "_l" by "_r".
#include <optional>
#include <string>
#include <vector>

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

// A leg as the clips' foot planting sees it: names of joints from the body down.
struct LegSpec {
  std::string blade;    // turns back and forth with the foot; empty for none
  std::string swing;    // solved: pitch and sideways
  std::string bend;     // solved: pitch
  std::string fold;     // pitch follows `bend` by `couple`, plus the fold of the gait's swing phase
  std::string pastern;  // where the planted point hangs from
  std::string foot;     // the planted point
  double couple = 0;    // turn of `fold` per turn of `bend` (the reciprocal apparatus of hind legs)
  bool mirror = true;
};

// Sinusoidal motion of a joint: offset + amplitude * sin(2 pi (cycles * t / duration + phase)).
struct WaveSpec {
  std::string joint;
  dvec3 amplitude_deg{0}, offset_deg{0};  // about the model axes, applied x, then y, then z
  dvec3 amplitude_m{0}, offset_m{0};      // of the joint's position
  int cycles = 1;                         // whole numbers, so that clips loop
  double phase = 0;                       // in turns
};

// Keyed motion of a joint, added to its waves; smooth between keys.
struct TrackSpec {
  std::string joint;
  std::vector<double> times;        // shares of the duration, ascending in [0, 1]
  std::vector<dvec3> rotation_deg;  // about the model axes, applied x, then y, then z
};

// A gait in place: planted feet move backwards under the body at walking speed.
struct GaitSpec {
  double stride = 1;           // metres the animal would advance per cycle
  double duty = 0.62;          // share of the cycle a foot is on the ground
  double lift = 0.1;           // metres the foot rises in its swing
  double fold_deg = 0;         // peak extra flexion of the `fold` joints of legs without coupling
  double pastern_deg = 30;     // peak backward flexion of the foot in its swing
  double blade_deg = 0;        // blade rotation at the ends of a step
  std::vector<double> phases;  // per LegSpec, left then right of each: when its stance begins, in cycles
};

struct ClipSpec {
  std::string name;
  double duration = 1;  // seconds
  int keys = 24;        // per loop
  std::vector<WaveSpec> waves;
  std::vector<TrackSpec> tracks;
  std::optional<GaitSpec> gait;  // feet that no gait moves stay planted where they stand
};

struct QuadrupedSpec {
  std::string source;          // file, for messages
  double target_edge = 0.025;  // metres; what triangle edges are like where `detail` is 1
  double grid = 0.011;         // metres; resolves the thinnest part, whatever the target edge
  double gutter = 0.004;       // free border around UV charts, share of the atlas' side
  std::vector<QuadrupedJoint> joints;
  std::vector<Solid> solids;
  std::vector<LegSpec> legs;
  std::vector<ClipSpec> clips;
};

// A closed, two-manifold, left/right symmetric skinned mesh with UV atlas, parts and clips. The same bytes for any
// number of threads. Throws InputError where the spec contradicts itself (unknown joints, solids that do not touch).
Rig build_quadruped(const QuadrupedSpec& spec);

// "left_fore_elbow" -> "right_fore_elbow", "ear_l" -> "ear_r"; names of the midline stay.
std::string mirror_name(const std::string& name);

}  // namespace moomill
