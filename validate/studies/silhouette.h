#pragma once
// How well the shape of a rig agrees with that of a reference mesh: overlap of their orthographic silhouettes from the
// side, the front and the top, after fitting what does not belong to the shape (place, pose) and three scales.
//
// A file beforehand (validate/silhouettes/*.toml) fixes the reference, what is left out on both sides, and which joints
// may turn how far. Nothing here calls the renderer: triangles are projected by dropping a coordinate and filled where
// they cover pixel centres, so the silhouette is their union, and holes, double sides or loose parts do not matter.
#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "generator/core/image.h"
#include "rigs/species.h"
#include "validate/studies/study.h"

namespace moomill {

// Triangles of the reference whose centroid lies in the box are left out.
struct LeftOut {
  std::string what;
  Box box;  // metres, reference frame
};

// A turn of one of our joints that is fitted, about a model axis as in Species::limits.
struct FittedTurn {
  std::string joint;
  int axis = 1;               // 0, 1, 2: about x (roll), y (pitch), z (yaw)
  double lower_deg = 0, upper_deg = 0;
  bool mirror = false;        // its twin on the other side turns as its mirror image
};

// The reference frame: metres, +X forward, Z up; the whole mesh, nothing left out, is `height` high, stands on z = 0
// and is centred on x = y = 0.
struct SilhouetteReference {
  std::string name;
  std::filesystem::path file;  // of the mesh
  double yaw_deg = 0;          // turns it to face +X
  double height = 1;           // metres, true height of the whole mesh
  std::vector<LeftOut> left_out;
  std::vector<std::string> left_out_parts;  // of ours: part names, * stands for any letters
  std::vector<FittedTurn> turns;
  std::array<std::optional<double>, 3> at_least;  // bar of the overlap: side, front, top
};

inline constexpr std::array<const char*, 3> silhouette_views{"side", "front", "top"};
inline constexpr std::array<std::array<int, 2>, 3> silhouette_axes{{{0, 2}, {1, 2}, {0, 1}}};  // across, up the picture

// Reads such a file. The mesh is looked for beside it, below the project's folder and below ../shared/assets of it.
// InputError where anything is missing or contradicts itself.
SilhouetteReference read_silhouette_reference(const std::filesystem::path& file);

// Triangles as points; what both sides become before they are drawn.
struct SilhouetteMesh {
  std::vector<dvec3> points;  // metres
  std::vector<uvec3> triangles;
};

// The reference in its frame, without what is left out. InputError where a box holds no triangle.
SilhouetteMesh load_silhouette_reference(const SilhouetteReference& reference);

// Pixel (i, j) covers [lower + i * pixel, lower + (i + 1) * pixel] across, and upwards likewise (row 0 is lowest).
struct SilhouetteGrid {
  int width = 0, height = 0;
  double pixel = 0.01;  // metres
  dvec2 lower{0};       // metres
};

// 1 where a pixel's centre lies in a triangle or on its edge, else 0.
Image8 draw_silhouette(const SilhouetteMesh& mesh, const std::array<int, 2>& axes, const SilhouetteGrid& grid);

// |A and B| / |A or B|; 0 where both are empty.
double intersection_over_union(const Image8& a, const Image8& b);

struct SilhouetteFit {
  dvec3 offset{0};                   // metres, after the scales
  dvec3 scale{1};                    // length, width, height
  std::vector<double> turns_deg;     // one per SilhouetteReference::turns
  std::array<double, 3> overlap{};   // side, front, top
  std::array<double, 3> reference_only{}, ours_only{};  // square metres
  std::vector<std::string> parts_left_out;              // of ours
  std::array<Image8, 3> reference, ours;                // silhouettes as measured, row 0 lowest
  double pixel = 0;                                     // metres
};

// Maximises the mean overlap of the three views over offset, scale (one of length, width and height each, applied to
// the posed mesh) and turns, all shared by the views: MA-ES (Beyer and Sendhoff, IEEE TEVC 2017) from three starts on
// coarse pictures, then on fine ones. Deterministic. InputError where the rig lacks a joint or all is left out.
SilhouetteFit fit_silhouettes(const Species& species, const SilhouetteReference& reference);

// The same with the reference's mesh at hand.
SilhouetteFit fit_silhouettes(const Species& species, const SilhouetteReference& reference, const SilhouetteMesh& mesh);

// Side, front and top on one sheet: reference alone red, ours alone blue, both grey.
Image8 silhouette_sheet(const SilhouetteFit& fit, const std::string& title);

StudyResult silhouette_study(const Species& species, const SilhouetteReference& reference, const SilhouetteFit& fit);

}  // namespace moomill
