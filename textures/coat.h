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
#include "generator/core/surface.h"

namespace moomill {

// Large ragged patches on a ground colour (Holstein and alike). Lengths in metres on the neutral animal.
struct PatchPattern {
  vec3 ground{0.85f}, patch{0.02f};  // linear Rec. 709
  double scale = 0.45;               // typical patch size
  double share = 0.5;                // about which share of the surface the patches cover
  double raggedness = 0.02;          // border displacement
  double edge_softness = 0.004;
  double low = 0, high = 0;         // heights: no patches below `low`, as many as ever above `high` (white legs)
  std::optional<double> threshold;  // noise level where patches begin; calibrated() sets it so that `share` holds
};

// One colour with a slow variation, optionally lighter belly.
struct PlainPattern {
  vec3 color{0.4f, 0.2f, 0.08f};
  double variation = 0.1;        // relative
  double variation_scale = 0.3;  // metres
};

struct Freckles {
  vec3 color{0.03f};
  double density = 0;  // share of the surface covered, 0 for none, at most 0.25
  double size = 0.02;  // metres
};

// A colour for named body parts (rig part names; a trailing * matches the rest of the name).
struct PartColor {
  std::string part;
  vec3 color{0.5f};
  double softness = 0.01;  // metres over which it fades at the part's border, where the baker can
};

// A blaze, a star, a belt: a ragged ellipsoid of another colour, over patches and freckles, under part colours.
struct Mark {
  dvec3 at{0}, radii{0.1};  // metres
  vec3 color{0.85f};
  double raggedness = 0.01, softness = 0.005;  // metres
  bool mirror = false;                         // also at -y
};

struct ProceduralCoat {
  std::variant<PatchPattern, PlainPattern> base;
  Freckles freckles;
  std::vector<Mark> marks;
  double fur = 0.05;  // relative brightness variation of single tufts
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
};

// The coat with its patches' threshold set so that they cover their share of this very surface.
ProceduralCoat calibrated(ProceduralCoat coat, const Surface& surface);

// Base colour of a procedural coat at a point of the neutral animal (metres). Linear Rec. 709 in [0, 1]. Part
// colours end sharply here; bake_coat() fades them. A coat that is not calibrated() meets its share only on average.
vec3 coat_color(const ProceduralCoat& coat, const dvec3& neutral, const vec3& normal, const std::string& part);

// Bakes a procedural coat, calibrated, over the surface's UV atlas: 8-bit sRGB, 3 channels, resolution x resolution,
// with the islands' colours bled outwards so that bilinear look-ups never meet an unpainted texel. Parallel,
// deterministic. Throws InputError when the surface has no UVs.
Image8 bake_coat(const ProceduralCoat& coat, const Surface& surface, const std::vector<std::string>& part_names,
                 int resolution);

}  // namespace moomill
