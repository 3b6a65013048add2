#pragma once
// The hide: an animal's surface as coats and finishes see it. Everything here is of the neutral animal, computed once
// per rig and shared by all its coats: which way the hair lies, how far every vertex is inside of a body part, where
// parts are. So coats are written for bodies, not for meshes or UV atlases, and survive another mesh.
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "generator/core/image.h"
#include "generator/core/math.h"
#include "generator/core/surface.h"

namespace moomill {

// How hair lies. Directions are of the model's axes (facing +X, Z up) on the left side, mirrored to the right one; they
// are laid onto the surface and smoothed across it.
struct Hair {
  vec3 direction{-0.75f, 0, -0.65f};
  std::vector<std::pair<std::string, vec3>> parts;  // other directions, by part (a trailing * matches the rest)
  double smoothing = 0.08;                          // metres over which directions of neighbouring parts blend
  double tuft_width = 0.005, tuft_length = 0.03;    // metres: what hairs clump to
};

// The box of a part along its own axes: the longest within the plane of symmetry, pointing forwards (upwards where it
// is within 20 degrees of vertical), the animal's left, and the one square to both. Survives another inclination.
struct PartFrame {
  dvec3 centre{0};   // metres
  dmat3 axes{1.0};   // columns, unit
  dvec3 half{0};     // metres, half the box's size
  bool empty() const { return half == dvec3(0); }
};

// One point of it. What a coat needs to say its colour.
struct HidePoint {
  dvec3 at{0};               // metres
  vec3 normal{0, 0, 1};      // unit
  vec3 hair{0};              // unit and tangent, the way hair lies; 0 for unknown
  float streak = 0;          // hair_streak() here
  std::span<const float> inside;  // metres inside of each part pattern (negative: outside), as Hide::patterns
};

struct Hide {
  const Surface* surface = nullptr;      // not owned; outlives the hide
  std::vector<std::string> part_names;
  Hair hair;
  Box box;                               // metres, of what triangles use
  std::vector<std::uint32_t> welded;     // per vertex: number of its position
  std::size_t welded_count = 0;
  std::vector<vec3> positions;           // per welded vertex, metres
  std::vector<std::uint32_t> neighbour_begin, neighbours;  // per welded vertex (one more at the end): those it shares
                                                           // an edge with, ascending
  std::vector<vec3> normals, hairs;      // per vertex; equal where positions are
  std::vector<std::string> patterns;     // part patterns somebody asked for ("hoof_*")
  std::vector<std::vector<float>> inside;  // per pattern and vertex, metres; clamped at -part_reach
  std::vector<float> deepest;            // per pattern: the largest value of `inside`, metres
  struct Sample {
    std::uint32_t triangle;
    vec3 weights;  // barycentrics
  };
  std::vector<Sample> samples;  // spread evenly over the surface, each for the same area
  double area = 0;              // square metres

  int pattern(const std::string& name) const;  // index into `patterns`; check()s that it is known
};
inline constexpr float part_reach = 0.3f;  // metres outside of a part that are still measured

Hide make_hide(const Surface& surface, const std::vector<std::string>& part_names, const Hair& hair = {});

// Measures how far every vertex is inside of the parts a pattern names, unless that is known already.
void know_part(Hide& hide, const std::string& pattern);
bool part_matches(const std::string& pattern, const std::string& part);
PartFrame part_frame(const Hide& hide, const std::string& pattern);  // empty where the rig has no such part

// The point with these barycentrics. `inside` holds the values its `inside` refers to: one per pattern.
HidePoint hide_point(const Hide& hide, std::uint32_t triangle, const dvec3& weights, std::vector<float>& inside,
                     bool with_streak = true);

// Brightness of hair tufts in about [-1, 1], mean 0: noise drawn out along the hair (line integral convolution, Cabral
// and Leedom 1993). The same for every coat of an animal, like the finish that goes with it.
float hair_streak(const Hair& hair, const dvec3& at, const vec3& direction);

// Which triangle paints which texel, and what no coat enters. Shared by all coats baked at one resolution.
struct TexelMap {
  int resolution = 0;
  ImageU32 owner;             // triangle, or texel_nobody
  std::vector<float> streak;  // per texel
};
inline constexpr std::uint32_t texel_nobody = 0xffffffffu;
// Throws InputError when the surface has no UVs or the resolution is none.
TexelMap map_texels(const Hide& hide, int resolution);
// Barycentrics of a texel's centre in its triangle; beyond the triangle's borders carried on, but not far.
dvec3 texel_barycentrics(const Surface& surface, std::uint32_t triangle, int resolution, int x, int y);

}  // namespace moomill
