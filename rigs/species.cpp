#include "rigs/species.h"

#include <glm/gtc/matrix_inverse.hpp>

#include "generator/core/error.h"

namespace moomill {

std::vector<dvec3> keypoint_positions(const Species& species, const std::vector<dmat4>& world,
                                      const std::vector<dmat4>& neutral_world, const PosedSurface& posed) {
  std::vector<dvec3> points;
  points.reserve(species.keypoints.size());
  for (const Keypoint& keypoint : species.keypoints) {
    if (const auto* joint = std::get_if<JointAnchor>(&keypoint.anchor)) {
      const dmat4& rest = neutral_world[joint->node];
      // A joint scaled to nothing has no frame to hold an offset in: the point sits on it.
      const bool invertible = std::abs(glm::determinant(dmat3(rest))) > 1e-30;
      const dvec3 offset = invertible ? transform_point(glm::affineInverse(rest), joint->neutral) : dvec3(0);
      points.push_back(transform_point(world[joint->node], offset));
    } else {
      const auto& anchor = std::get<SurfaceAnchor>(keypoint.anchor);
      const uvec3& t = species.rig.surface.triangles[anchor.triangle];
      const dvec2 b = anchor.barycentrics;
      points.push_back(posed.origin + (1 - b.x - b.y) * dvec3(posed.positions[t[0]]) +
                       b.x * dvec3(posed.positions[t[1]]) + b.y * dvec3(posed.positions[t[2]]));
    }
  }
  return points;
}

Pose sample_within_limits(const Species& species, const std::vector<double>& uniforms) {
  const Rig& rig = species.rig;
  Pose neutral = species.neutral;
  if (neutral.local.empty()) neutral = bind_pose(rig);
  Pose pose = neutral;
  neutral.placement = dmat4(1.0);
  const std::vector<dmat4> world = world_transforms(rig, neutral);
  for (std::size_t i = 0; i < species.limits.size(); ++i) {
    const JointLimit& limit = species.limits[i];
    const dvec3 lower = limit.sampled_lower(), upper = limit.sampled_upper();
    dvec3 angle;
    for (int axis = 0; axis < 3; ++axis) {
      const std::size_t k = 3 * i + axis;
      const double u = k < uniforms.size() ? uniforms[k] : 0.5;
      angle[axis] = (lower[axis] + u * (upper[axis] - lower[axis])) * degrees;
    }
    // About x, then y, then z of the model space as the neutral pose has it; the parent carries these axes along.
    const dquat turn = glm::angleAxis(angle.z, dvec3(0, 0, 1)) * glm::angleAxis(angle.y, dvec3(0, 1, 0)) *
                       glm::angleAxis(angle.x, dvec3(1, 0, 0));
    const int parent = rig.nodes[limit.node].parent;
    const dquat frame = parent < 0 ? dquat(1, 0, 0, 0) : decompose(world[parent]).rotation;
    LocalTransform local = local_transform(rig, pose, limit.node);
    local.rotation = glm::normalize(glm::conjugate(frame) * turn * frame * local.rotation);
    pose.local[limit.node] = local;
  }
  return pose;
}

}  // namespace moomill
