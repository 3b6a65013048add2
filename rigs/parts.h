#pragma once
// The kit of parts: eyes, ears, nostrils, horns, hooves and what else an animal is told by, each from a few measures as
// a breeder would give them. A part expands into solids that the quadruped builder knows; no species is named here.
//
// Parts are described on the left (y > 0) or on the midline; those of the left get their right-hand twin by themselves.
// `offset` is in metres from the joint, along the model's axes (X forward, Y to the left, Z up), in the neutral pose.
// Eyes, nostrils, ears and horns then slide to the nearest skin, so they follow when the head's shape changes.
//
// To add a kind of part: a struct here, its case in parts.cpp, its keys in scenes/parts_file.cpp.
#include <string>
#include <variant>
#include <vector>

#include "rigs/quadruped.h"

namespace moomill {

// A dark ball between lids, under a brow. Parts: eye_l, eyelid_l; the brow belongs to `PartSpec::part`.
struct EyePart {
  double length = 0.045;  // metres from corner to corner
  double height = 0.030;  // metres between the lids
  double bulge = 0.010;   // metres the lids' rim stands out of the skin
  double slant_deg = 20;  // how far the front corner is below the back one
  double brow = 0.008;    // metres the bone above stands out; 0 for none
};

// A leaf with a hollow, on the joint that turns it. Part: ear_l.
struct EarPart {
  double length = 0.20, width = 0.10;  // metres
  double set_deg = 0;      // how far it points up: 0 level, 90 straight up
  double forward_deg = 0;  // how far it points forward: 0 sideways
  double opening_deg = 0;  // where the hollow looks: 0 forward, 90 outward and down
  double cup = 0.018;      // metres, depth of the hollow
  double thickness = 0.008;  // metres, of the shell; never less than the builder's grid can hold
  double tip = 0.25;       // width near the tip, share of the widest: small is pointed
};

// A comma cut into the muzzle.
struct NostrilPart {
  double length = 0.045, width = 0.022, depth = 0.02;  // metres
  double slant_deg = 50;                               // how steeply its tail rises backwards
  double flare = 0.004;                                // metres its rim stands out
};

// From the coronet to the ground. Part: hoof_fore_left for joint left_fore_hoof, and so on.
struct HoofPart {
  bool cloven = true;
  double width = 0.12, length = 0.125, height = 0.078;  // metres: both claws at the sole; toe to heel; of the toe
  double toe_deg = 52;                                  // slope of the front wall
  double cleft = 0.010;                                 // metres between the claws
  double coronet = 0.003;                               // metres the band above the horn stands out
};

// Two small claws behind the fetlock. Part: as the hoof's.
struct DewclawPart {
  double size = 0.026;     // metres long
  double spacing = 0.046;  // metres from one to the other
};

// The line between the lips, cut from the front of the muzzle to the corners. Part: as the skin it cuts.
struct MouthPart {
  double length = 0.12, width = 0.10;  // metres: from the front to the corners; from corner to corner
  double slant_deg = 45;               // how steeply it rises backwards
  double gape = 0.006, depth = 0.008;  // metres
};

// A horn, or with a knob an ossicone. Part: horn_l, ossicone_l.
struct HornPart {
  double length = 0.16, thickness = 0.045;  // metres along its bend; diameter at the base
  double set_deg = 20, forward_deg = 10;    // where its base points: above level, ahead of sideways
  double curve_deg = 50;                    // by how much it turns upwards along its length
  double tip = 0.3;                         // thickness at the tip, share of the base's
  double knob = 0;                          // metres, diameter of the knob at its end; 0 for none
};

// A bone under the skin: hook, pin, point of the shoulder, wither. Part: torso.
struct BonePart {
  double size = 0.08;     // metres across
  double out = 0.02;      // metres it stands out of the skin
  double blend = 0.09;    // metres over which it fades
};

// A fold of skin hanging below the neck, from the part's joint and offset to another. Part: neck.
struct DewlapPart {
  std::string to_joint;
  dvec3 to_offset{0};
  double depth = 0.08, thickness = 0.035;  // metres
};

// Hangs from the belly below its joint. Part: udder.
struct UdderPart {
  double length = 0.34, width = 0.30, depth = 0.20;  // metres
  int teats = 4;                                     // 4, 2 (abreast) or 0
  double teat = 0.055;                               // metres long
};

// Along joints from the dock to the tip. Parts: tail, and tail_switch where there is hair.
struct TailPart {
  std::vector<std::string> along;          // joints; the last is the tip
  double thickness = 0.07, tip = 0.03;     // metres, diameter of the dock and of its end
  double hair_from = 0.7;                  // share of the length where the hair begins; 1 for none
  double hair = 0.07;                      // metres, diameter of the hair where it is fullest
};

// Hair along the crest of the neck, between joints: upright, or falling to both sides. Part: mane.
struct ManePart {
  std::vector<std::string> along;            // joints, from the withers to the poll
  double height = 0.05, thickness = 0.035;   // metres
  double fall = 0;                           // metres it hangs down the neck's sides
  double forelock = 0;                       // metres it hangs down the forehead
};

struct PartSpec {
  std::string name;   // for messages
  std::string joint;  // what it moves with
  dvec3 offset{0};    // metres from the joint
  std::string part;   // body part it belongs to; empty: that of its kind
  std::variant<EyePart, EarPart, NostrilPart, HoofPart, DewclawPart, MouthPart, HornPart, BonePart, DewlapPart,
               UdderPart, TailPart, ManePart>
      kind;
};

// The solids of `parts` on `body`, in order, to be put behind the body's own. Pure; `body` gives joints, the skin to
// stand on, grid and target edge. Throws InputError on unknown joints and on parts that find no skin near them.
std::vector<Solid> expand_parts(const std::vector<PartSpec>& parts, const QuadrupedSpec& body);

}  // namespace moomill
