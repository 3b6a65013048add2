#pragma once
// Motion as data: clips of a four-legged animal from gaits, steps, keys and waves, with feet planted by inverse
// kinematics. The files are read by scenes/motion_file.cpp; their keys are explained in rigs/cow/motion/README.md.
//
// Lengths are in leg lengths: the mean height above the ground, in the neutral pose, of the topmost joint of every leg.
// Angles turn joints about the axes of the model (x forward, y to the left, z up), x first, then y, then z. So a motion
// carries over to another animal whose joints have the same names.
#include <optional>
#include <string>
#include <vector>

#include "rigs/rig.h"
#include "rigs/species.h"

namespace moomill {

// A leg: names of joints from the body down. Where motion files speak of a leg they name its foot.
struct LegSpec {
  std::string blade;    // follows the leg's swing by `blade_share`; empty for none
  std::string swing;    // solved: pitch and sideways
  std::string bend;     // solved: pitch
  std::string fold;     // pitch follows `bend` by `couple`, plus what the gait folds
  std::string pastern;  // carries the foot
  std::string foot;     // the planted hoof
  double couple = 0;    // turn of `fold` per turn of `bend` (the reciprocal apparatus of hind legs)
  double blade_share = 0.35;
  bool mirror = true;
};

// Sinusoidal motion of a joint: offset + amplitude * sin(2 pi (cycles * t / duration + phase)).
struct WaveSpec {
  std::string joint;
  dvec3 amplitude_deg{0}, offset_deg{0};
  dvec3 amplitude{0}, offset{0};  // leg lengths, of the joint's position
  int cycles = 1;                 // whole numbers, so that clips loop
  double phase = 0;               // in turns
};

// Keyed motion of a joint, added to its waves; smooth between keys.
struct TrackSpec {
  std::string joint;
  std::vector<double> times;        // shares of the duration, ascending in [0, 1]
  std::vector<dvec3> rotation_deg;  // per time; or empty
  std::vector<dvec3> shift;         // leg lengths, per time; or empty
};

// Legs that step alike in a gait.
struct GaitLegs {
  std::vector<std::string> feet;
  std::vector<double> phases;  // per foot: when its stance begins, in cycles
  double lift = 0.07;          // leg lengths the toe rises in its swing
  double fold_deg = 0;         // peak flexion of `fold` joints without coupling in the swing
  double pastern_deg = 30;     // peak flexion of the pastern in the swing
  double load_deg = 6;         // how far the fetlock sinks under load
  double toe_deg = 30;         // the hoof's roll over its toe when it leaves the ground
  double heel_deg = 4;         // the same over its heel when it lands
  dvec2 at{0};                 // leg lengths: middle of the stance from where the foot stands; forward, outward
};

struct GaitSpec {
  double stride = 1.2;  // leg lengths the animal advances per cycle; a clip is one cycle
  double duty = 0.65;   // share of the cycle a foot is on the ground
  std::vector<GaitLegs> legs;
};

// A foot is put elsewhere, and stays there until its next step.
struct StepSpec {
  std::string foot;
  double begin = 0, end = 0;  // shares of the duration
  dvec2 to{0};                // leg lengths from where it stands in the neutral pose; forward, outward
  double lift = 0.05;         // leg lengths
};

// A leg folds and lies on the ground from its `fold` joint down: the knees of a lying animal.
struct RestSpec {
  std::string foot;
  std::vector<double> times;  // share when it begins to fold, when it lies, when it begins to unfold, when it stands
  dvec2 at{0};                // leg lengths: the fold joint from where it is in the neutral pose; forward, outward
  double pitch_deg = 90;      // of the lower leg: 90 lies backwards, -90 forwards
  double pastern_deg = 0;     // flexion of the pastern
};

// The skin of a joint comes down to a height over the ground: turns in full measure, or as far as it takes.
struct ReachSpec {
  std::string joint;                // its skin, and that of the joints below it
  std::vector<double> times;        // shares of the duration
  std::vector<double> amounts;      // per time, 0 to 1: how much of the way
  double height = 0.02;             // leg lengths over the ground
  std::vector<std::string> joints;  // what turns
  std::vector<dvec3> turns_deg;     // per joint, in full measure; up to `most` times that
  double most = 1.5;
};

// The skin of some joints is put on the ground by raising or lowering the body.
struct SettleSpec {
  std::vector<std::string> joints;
  std::vector<double> times, amounts;  // as in ReachSpec
};

struct ClipSpec {
  std::string source;  // file, for messages
  std::string name;
  double duration = 1;    // seconds
  int keys = 24;          // per clip
  bool loops = true;      // its end is its beginning
  bool in_place = false;  // a gait without advance: planted feet slide back under the body
  std::vector<WaveSpec> waves;
  std::vector<TrackSpec> tracks;
  std::optional<GaitSpec> gait;
  std::vector<StepSpec> steps;  // feet that neither gait nor step moves stay planted where they stand
  std::vector<RestSpec> rests;
  std::vector<ReachSpec> reaches;
  std::optional<SettleSpec> settle;
};

struct Motion {
  std::vector<Clip> clips;  // linear quaternion and translation channels
  std::vector<ClipPlan> plans;
};

// Clips for any rig that has the joints, whatever its local axes. `neutral`: the pose the animal stands in; `limits`: what
// inverse kinematics keeps to. `legs_source`: the file of the legs, for messages. Throws InputError on unknown joints.
Motion build_motion(const std::string& legs_source, const std::vector<LegSpec>& legs,
                    const std::vector<ClipSpec>& clips, const Rig& rig, const Pose& neutral,
                    const std::vector<JointLimit>& limits);

// "left_fore_elbow" -> "right_fore_elbow", "ear_l" -> "ear_r"; names of the midline stay.
std::string mirror_name(const std::string& name);

}  // namespace moomill
