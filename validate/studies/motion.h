#pragma once
// How well an animal moves: do feet stand on the ground without sliding, do joints stay within their limits, do loops
// close, how varied are the poses of a scene, does every camera see the whole animal. Measured on the skinned mesh.
#include <optional>

#include "scenes/scene.h"
#include "validate/studies/study.h"

namespace moomill {

struct MotionOptions {
  int samples = 200;  // per clip
};

// Every clip of the species. Which foot bears weight when is taken from what made the clip (Species::clip_plans); of other
// clips, as those of imported rigs, it is found from the mesh: the ground is where the lowest foot mostly is, a foot bears
// weight where it comes within 1.5 cm of it (at the size of a cow), and these clips are held against no bound.
StudyResult study_motion(const Species& species, const MotionOptions& options);

// The same of the first animal of a scene, and: the spread of its poses' keypoints, random poses on the ground, and how far
// from the border every pose is in every camera.
StudyResult study_motion(const SceneSpec& scene, const Species& species, const MotionOptions& options);

// Angles of a node against the neutral pose about the model's axes, x first, then y, then z, degrees: of the two triples
// that mean the same turn the one that is less beyond the limit. `excess`: by how much, 0 within.
struct JointAngles {
  dvec3 deg{0};
  double excess = 0;
};
JointAngles joint_angles(const Rig& rig, const Pose& neutral, const Pose& pose, const JointLimit& limit);

}  // namespace moomill
