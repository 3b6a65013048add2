#pragma once
// How well an animal's skin holds when it moves: volume, triangles turned inside out, cross-sections at the joints, for
// linear blend and dual quaternion skinning beside each other.
#include <string>
#include <vector>

#include "rigs/species.h"
#include "validate/studies/study.h"

namespace moomill {

// A closed curve on the surface around a joint: where a plane square to the limb cuts the bind pose. Its points stay on
// their edges when the animal moves.
struct Ring {
  int node = 0;
  double offset = 0;  // metres along the limb from the joint
  struct Point {
    std::uint32_t a = 0, b = 0;  // vertices of the edge
    double share = 0;            // from a to b
  };
  std::vector<Point> points;
  double area = 0;  // square metres, in the bind pose
};

// What the measures need of the surface at rest.
struct DeformationReference {
  std::vector<std::uint32_t> place;  // per vertex: one number per distinct position, so seams of UVs are no borders
  std::vector<dvec3> normals;        // per triangle, unit; zero where the triangle has no area
  std::vector<double> areas;         // per triangle, square metres
  double area = 0;
  bool closed = false;  // every edge has two triangles, once in either direction
  std::vector<Ring> rings;
};
DeformationReference deformation_reference(const Rig& rig);

struct Deformation {
  double volume = 0;    // cubic metres, signed (divergence theorem)
  double inverted = 0;  // share of the rest area in triangles turned against the normal that their bones' rotations, blended, give them
  double crushed = 0;   // share of the rest area in triangles squeezed in some direction to less than a quarter
  double seam = 0;      // metres, largest distance between vertices that are one place at rest
  bool finite = true;
  std::vector<double> rings;  // per ring: length of its vector area over that at rest; 1 rigidly moved, 0 collapsed
};
// `bones`: as from bone_matrices(); `posed`: what skin() makes of them.
Deformation measure_deformation(const Rig& rig, const DeformationReference& reference, const std::vector<dmat4>& bones,
                                const PosedSurface& posed);

// All poses by both methods, and every joint limit, at it and half past it. Bounds: volume within 8 % of neutral, 0.1 % of the area inverted,
// ring areas at least `smallest_ring`; held for the species' own method.
inline constexpr double smallest_ring = 0.5;  // what linear blending leaves of a tube twisted by 90 degrees: cos^2(45)
StudyResult study_deformation(const Species& species, const std::vector<Pose>& poses, int first_frame);

}  // namespace moomill
