#pragma once
// What one species file (rigs/<species>/<species>.toml) says, as plain data. Read by scenes/species_file.cpp.
#include <array>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "rigs/pose.h"
#include "rigs/rig.h"

namespace moomill {

// A point that moves rigidly with a node. `neutral` is where it is in the neutral pose (model space, metres).
struct JointAnchor {
  int node = 0;
  dvec3 neutral{0};
};

// A point on the surface.
struct SurfaceAnchor {
  std::uint32_t triangle = 0;
  dvec2 barycentrics{0};  // of the triangle's second and third vertex
};

struct Keypoint {
  std::string name;
  std::variant<JointAnchor, SurfaceAnchor> anchor;
  double tolerance = 0.02;  // metres the point may lie behind the visible surface and still count as visible
};

// Rotation limits of a node about the axes of the model space in the neutral pose, degrees: x first, then y, then z.
struct JointLimit {
  int node = 0;
  dvec3 lower_deg{0}, upper_deg{0};                            // what the joint can do
  std::optional<dvec3> usual_lower_deg{}, usual_upper_deg{};  // what random poses are drawn from; empty: all of it
  dvec3 sampled_lower() const { return usual_lower_deg.value_or(lower_deg); }
  dvec3 sampled_upper() const { return usual_upper_deg.value_or(upper_deg); }
};

// What a clip was made to do, where that is known: what `moomill rig motion` holds the clip against.
struct Contact {
  int node = 0;              // the foot that bears weight
  double begin = 0, end = 0;  // seconds
};
struct ClipPlan {
  std::string clip;
  bool loops = true;
  double advance = 0;  // metres along +X that bearing feet go back by in the clip, less what the root travels
  std::vector<Contact> contacts;
};

struct Species {
  std::string name;        // also the folder name and the <species> of dataset paths
  Rig rig;                 // loaded or built, with nnopcs baked
  std::vector<Keypoint> keypoints;
  std::vector<std::pair<int, int>> edges;  // skeleton, keypoint indices
  std::vector<std::pair<int, int>> pairs;  // left, right keypoint indices
  std::vector<JointLimit> limits;
  std::vector<ClipPlan> clip_plans;        // of the clips that motion files made
  Pose neutral;                            // what NNOPCS is baked from
  dvec3 standing{0};                       // metres, added to model space before yaw and position: puts it on z = 0
  SkinningMethod skinning = SkinningMethod::linear_blend;
  std::optional<double> expected_length, expected_height;  // metres, for `rig check`
  double reader_radius = 1.5;              // the r of netepu.md: keypoints are divided by 2 r
};

// Keypoints in world metres for one pose. `world` as from world_transforms(); `neutral_world` the same of
// species.neutral; posed: the skinned surface of that pose.
std::vector<dvec3> keypoint_positions(const Species& species, const std::vector<dmat4>& world,
                                      const std::vector<dmat4>& neutral_world, const PosedSurface& posed);

// A pose drawn uniformly within what is usual of the species' joint limits; u(i) gives the i-th uniform number in [0, 1).
Pose sample_within_limits(const Species& species, const std::vector<double>& uniforms);

}  // namespace moomill
