#pragma once
// Poses as data, forward kinematics in double, and skinning.
#include <optional>
#include <string>
#include <vector>

#include "rigs/rig.h"

namespace moomill {

struct LocalTransform {
  dvec3 translation{0};
  dquat rotation{1, 0, 0, 0};
  dvec3 scale{1};
};

// One pose of a rig: a local transform per node (std::nullopt: the node keeps its matrix or rest transform).
struct Pose {
  std::vector<std::optional<LocalTransform>> local;
  std::vector<double> morph_weights;  // empty: the rig's defaults
  dmat4 placement{1.0};               // model space to world
};

dmat4 compose(const LocalTransform& local);

// The closest translation, rotation, scale; shear is lost, a mirror becomes negative scales. Finite for any finite matrix.
LocalTransform decompose(const dmat4& matrix);

// Transform of a node in its parent: from the pose, else the node's own.
dmat4 local_matrix(const Rig& rig, const Pose& pose, int node);
LocalTransform local_transform(const Rig& rig, const Pose& pose, int node);

Pose bind_pose(const Rig& rig);  // every node as in the file

// The pose whose skinned vertices are Surface::rest: joints where their inverse bind matrices have them. Many files are
// saved in the middle of a clip, and there this differs from bind_pose().
Pose rest_pose(const Rig& rig);

// The rig at a time of a clip (seconds, clamped to the clip). Rotations: STEP, LINEAR (shortest arc), CUBICSPLINE as in glTF 2.0 appendix C.
Pose sample_clip(const Rig& rig, const Clip& clip, double time);

// Node to world, double. placement * parent * ... * local.
std::vector<dmat4> world_transforms(const Rig& rig, const Pose& pose);

enum class SkinningMethod : std::uint8_t { linear_blend, dual_quaternion };

// Bone matrices: bind-pose model space to world. One per Rig::bones.
std::vector<dmat4> bone_matrices(const Rig& rig, const std::vector<dmat4>& world);

// Posed vertices, world minus origin. Computed in double, stored in float; in parallel, bit-identical for any number
// of threads. Normals by the inverse transpose. Dual quaternions: Kavan et al. 2008, antipodality handled per vertex
// against the vertex's largest weight, scale and shear blended linearly before the rigid part.
PosedSurface skin(const Rig& rig, const std::vector<dmat4>& bones, const std::vector<double>& morph_weights,
                  SkinningMethod method, const dvec3& origin);

}  // namespace moomill
