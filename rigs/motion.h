#pragma once
// Motion as data: clips of a four-legged animal from gaits, keys and waves, with feet planted by inverse kinematics.
#include <optional>
#include <string>
#include <vector>

#include "rigs/rig.h"

namespace moomill {

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
  std::string source;  // file, for messages
  std::string name;
  double duration = 1;  // seconds
  int keys = 24;        // per loop
  std::vector<WaveSpec> waves;
  std::vector<TrackSpec> tracks;
  std::optional<GaitSpec> gait;  // feet that no gait moves stay planted where they stand
};

// One clip per ClipSpec, sampled into linear quaternion and translation channels. `legs_source`: the file of the legs, for
// messages. Throws InputError on unknown joints.
std::vector<Clip> build_clips(const std::string& legs_source, const std::vector<LegSpec>& legs,
                              const std::vector<ClipSpec>& clips, const Rig& rig);

// "left_fore_elbow" -> "right_fore_elbow", "ear_l" -> "ear_r"; names of the midline stay.
std::string mirror_name(const std::string& name);

}  // namespace moomill
