#pragma once
// Coats: what base colour an animal wears. A coat is data; baking it is a pure function of (coat, rig, resolution).
//
// To add a coat: write textures/<species>/<name>.toml (see textures/cow/README.md) and name it in a scene file, or
// name any PNG/JPEG in the rig's UV space. To add a kind of procedural coat: add a struct here, a case in coat.cpp,
// and its keys in scenes/coat_file.cpp.
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "generator/core/image.h"
#include "generator/core/math.h"
#include "textures/cells.h"
#include "textures/hide.h"

namespace moomill {

// Large ragged patches on a ground colour (Holstein and alike). Lengths in metres on the neutral animal.
struct PatchPattern {
  vec3 ground{0.74f}, patch{0.022f};  // linear Rec. 709
  double scale = 0.55;                // typical patch size
  double share = 0.5;                 // of the surface that patches cover, marks and parts aside
  double raggedness = 0.02;           // how far lobes and notches of the border reach
  double fringe = 0.012;              // how far single tufts of hair reach over it
  double edge_softness = 0.004;
  double skin_shadow = 0.008;         // width of the bluish band where dark skin shows through light hair
  double dorsal = 0.35;               // how much patches prefer the back to the belly; 0 not at all
  double low = 0, high = 0;           // shares of the animal's height: no patches below `low`, as many as ever above `high`
};

// One colour with a slow variation.
struct PlainPattern {
  vec3 color{0.4f, 0.2f, 0.08f};
  double variation = 0.1;        // relative
  double variation_scale = 0.3;  // metres
};

// Small spots of all sizes up to some, in loose groups.
struct Freckles {
  vec3 color{0.03f};
  double density = 0;     // share of the surface covered, 0 for none, at most 0.25
  double size = 0.02;     // metres, of the largest
  double clustering = 0.5;  // 0: evenly strewn; 1: bare and crowded places
};

// A blaze, a star, a belt: a ragged ellipsoid of another colour, over patches and freckles.
struct Mark {
  std::string part;               // whose frame `at` and `radii` are in, in half sizes of its box; empty: the model's, metres
  dvec3 at{0}, radii{0.1};
  vec3 color{0.74f};
  double raggedness = 0.01, fringe = 0.008, softness = 0.005;  // metres
  bool mirror = false;            // also on the right side
};

// A slow change of colour: darker backs, lighter bellies and inner legs, ears, dirt. Where all conditions meet.
struct Shade {
  vec3 color{0.5f};
  bool multiply = false;          // the colour is a factor
  double amount = 1;
  std::string part;               // only there (a trailing * matches the rest); empty: everywhere
  double softness = 0.05;         // metres over which it fades at the part's border, half outside
  std::optional<dvec2> heights;   // shares of the animal's height: from 0 at the first to all at the second
  vec3 facing{0};                 // surface that faces this way (left side; mirrored on the right); 0: any
  dvec2 facing_range{0.2, 0.8};   // cosines: from 0 at the first to all at the second
  double patchiness = 0;          // 0: even; 1: blotches with bare places
  double scale = 0.1;             // metres, of the blotches
};

// Bare skin, horn, hooves, eyes: a colour for named body parts (a trailing * matches the rest of the name).
struct PartColor {
  std::string part;
  vec3 color{0.5f};
  double softness = 0.01;              // metres over which it fades at the part's border
  double raggedness = 0.003;           // metres
  std::optional<vec3> halo;            // hair around it: pale muzzle rings and eye rings
  double halo_width = 0.03;            // metres
  std::optional<vec3> mottle;          // spots of another skin colour
  double mottle_share = 0.3, mottle_scale = 0.02;  // of the part; metres
  std::optional<vec3> tip;             // far from the part's border: horn tips, soles, pupils
  double tip_from = 0.5, tip_to = 1;   // shares of the way in: begins, complete
  double rings = 0, ring_spacing = 0.008;  // growth rings: relative brightness, metres
};

struct ProceduralCoat {
  std::variant<PatchPattern, PlainPattern, CellPattern> base;
  Freckles freckles;
  std::vector<Mark> marks;
  std::vector<Shade> shades;
  double fur = 0.08;  // relative brightness variation of tufts
  std::vector<PartColor> parts;
  std::uint64_t seed = 1;
};

// An image in the rig's UV space; decoded by the caller when needed.
struct ImageCoat {
  std::string file;
};

// The rig's own materials (base colour factor, texture, vertex colours).
struct OwnMaterials {};

struct Coat {
  std::string name;
  std::variant<ProceduralCoat, ImageCoat, OwnMaterials> source;
  std::string about;       // one line for people
  std::string looks_like;  // another coat it is meant to be hard to tell from; empty for none
};

// A coat fitted to one animal: patches begin where they cover their share of this very surface, names are looked up.
struct ReadyCoat {
  ProceduralCoat coat;
  CellField cells;                        // of a CellPattern
  double threshold = 0;                   // patch level where patches begin
  double floor = 0, height = 1;           // metres
  std::vector<PartFrame> mark_frames;     // per mark: centre, axes and radii in metres; empty where the part is missing
  std::vector<int> shade_parts, color_parts;  // into HidePoint::inside; -1 for everywhere
  std::vector<double> part_depths;        // per part colour: metres to its innermost point
};

// know_part() for all parts a coat names. Before the first ready_coat(); individuals of a breed share it.
void know_parts(Hide& hide, const ProceduralCoat& coat);
ReadyCoat ready_coat(const ProceduralCoat& coat, const Hide& hide);

// Base colour at a point. Linear Rec. 709 in [0, 1].
vec3 coat_color(const ReadyCoat& coat, const HidePoint& point);
// How far within a patch the point lies, about in metres (negative: on the ground). For statistics; 0 without patches.
double patch_depth(const ReadyCoat& coat, const HidePoint& point);

// Bakes a coat over the surface's UV atlas: 8-bit sRGB, 3 channels, with the islands' colours bled outwards so that
// bilinear look-ups never meet an unpainted texel. Parallel, deterministic.
Image8 bake_coat(const ReadyCoat& coat, const Hide& hide, const TexelMap& texels);
Image8 bake_coat(const ProceduralCoat& coat, Hide& hide, int resolution);  // all steps of it

// 8-bit sRGB of a linear value, exactly rounded.
std::uint8_t encode_srgb(float linear);

}  // namespace moomill
