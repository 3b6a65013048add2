#include "rigs/pose.h"

#include <glm/gtc/matrix_inverse.hpp>

#include "generator/core/error.h"

namespace moomill {
namespace {

dquat unit(const dquat& q) {
  const double length = std::sqrt(glm::dot(q, q));
  return length > 0 && std::isfinite(length) ? q / length : dquat(1, 0, 0, 0);
}

dquat slerp_shortest(dquat a, dquat b, double t) {
  a = unit(a);
  b = unit(b);
  double cosine = glm::dot(a, b);
  if (cosine < 0) b = -b, cosine = -cosine;
  if (cosine > 1 - 1e-12) return unit(a * (1 - t) + b * t);  // sin of the angle would vanish
  const double angle = std::acos(cosine);
  return unit((a * std::sin((1 - t) * angle) + b * std::sin(t * angle)) / std::sin(angle));
}

dquat quat_at(const double* v) {
  return dquat(v[3], v[0], v[1], v[2]);
}

// Values of a channel at a time; `width` values per key.
std::vector<double> sample_channel(const Channel& channel, double time, std::size_t width) {
  const bool cubic = channel.interpolation == Interpolation::cubic_spline;
  const std::size_t stride = cubic ? 3 * width : width, keys = channel.times.size();
  const auto value = [&](std::size_t key) { return channel.values.data() + key * stride + (cubic ? width : 0); };
  const auto copy = [&](std::size_t key) { return std::vector<double>(value(key), value(key) + width); };
  if (!(time > channel.times.front())) return copy(0);
  if (time >= channel.times.back()) return copy(keys - 1);
  const std::size_t next = std::upper_bound(channel.times.begin(), channel.times.end(), time) - channel.times.begin();
  const std::size_t key = next - 1;
  if (channel.interpolation == Interpolation::step) return copy(key);
  const double span = channel.times[next] - channel.times[key], t = (time - channel.times[key]) / span;
  if (!cubic && channel.path == ChannelPath::rotation) {
    const dquat q = slerp_shortest(quat_at(value(key)), quat_at(value(next)), t);
    return {q.x, q.y, q.z, q.w};
  }
  std::vector<double> result(width);
  const double t2 = t * t, t3 = t2 * t;
  for (std::size_t i = 0; i < width; ++i) {
    if (!cubic) {
      result[i] = (1 - t) * value(key)[i] + t * value(next)[i];
      continue;
    }
    const double out_tangent = value(key)[width + i];             // of this key
    const double in_tangent = channel.values[next * stride + i];  // of the next
    result[i] = (2 * t3 - 3 * t2 + 1) * value(key)[i] + span * (t3 - 2 * t2 + t) * out_tangent +
                (3 * t2 - 2 * t3) * value(next)[i] + span * (t3 - t2) * in_tangent;
  }
  return result;
}

}  // namespace

dmat4 compose(const LocalTransform& local) {
  dmat4 m = glm::mat4_cast(local.rotation);
  for (int i = 0; i < 3; ++i) m[i] *= local.scale[i];
  m[3] = dvec4(local.translation, 1);
  return m;
}

LocalTransform decompose(const dmat4& matrix) {
  LocalTransform local;
  local.translation = dvec3(matrix[3]);
  dmat3 m(matrix);
  for (int i = 0; i < 3; ++i) local.scale[i] = glm::length(m[i]);
  if (glm::determinant(m) < 0) local.scale.x = -local.scale.x;
  // Gram-Schmidt, longest axis first; axes that vanish are completed from the others.
  int order[3] = {0, 1, 2};
  std::stable_sort(order, order + 3, [&](int a, int b) { return std::abs(local.scale[a]) > std::abs(local.scale[b]); });
  if (!(std::abs(local.scale[order[0]]) > 0) || !all_finite(local.scale)) return local;
  dvec3 axis[3];
  const auto direction = [&](int i) { return m[i] / local.scale[i]; };
  axis[order[0]] = glm::normalize(direction(order[0]));
  dvec3 second(0);
  if (std::abs(local.scale[order[1]]) > 0) {
    second = direction(order[1]);
    second -= axis[order[0]] * glm::dot(second, axis[order[0]]);
  }
  if (!(glm::length(second) > 1e-9)) {
    const dvec3& a = axis[order[0]];
    second = glm::cross(a, std::abs(a.x) < 0.6   ? dvec3(1, 0, 0)
                           : std::abs(a.y) < 0.6 ? dvec3(0, 1, 0)
                                                 : dvec3(0, 0, 1));
  }
  axis[order[1]] = glm::normalize(second);
  // The third completes a right-handed frame in the order x, y, z.
  const bool even = (order[1] - order[0] + 3) % 3 == 1;
  axis[order[2]] = (even ? 1.0 : -1.0) * glm::cross(axis[order[0]], axis[order[1]]);
  local.rotation = unit(glm::quat_cast(dmat3(axis[0], axis[1], axis[2])));
  return local;
}

LocalTransform local_transform(const Rig& rig, const Pose& pose, int node) {
  if (pose.local[node]) return *pose.local[node];
  const Node& n = rig.nodes[node];
  return n.matrix ? decompose(*n.matrix) : LocalTransform{n.translation, n.rotation, n.scale};
}

dmat4 local_matrix(const Rig& rig, const Pose& pose, int node) {
  if (!pose.local[node] && rig.nodes[node].matrix) return *rig.nodes[node].matrix;
  return compose(local_transform(rig, pose, node));
}

Pose bind_pose(const Rig& rig) {
  Pose pose;
  pose.local.resize(rig.nodes.size());
  return pose;
}

Pose rest_pose(const Rig& rig) {
  Pose pose = bind_pose(rig);
  std::vector<const Bone*> bone_of(rig.nodes.size(), nullptr);
  for (const Bone& bone : rig.bones)
    if (!bone_of[bone.node] && std::abs(glm::determinant(dmat3(bone.inverse_bind))) > 1e-30) bone_of[bone.node] = &bone;
  std::vector<dmat4> world(rig.nodes.size());
  for (std::size_t i = 0; i < rig.nodes.size(); ++i) {
    const int parent = rig.nodes[i].parent;
    const dmat4 above = parent < 0 ? dmat4(1.0) : world[parent];
    if (bone_of[i] && std::abs(glm::determinant(dmat3(above))) > 1e-30)
      pose.local[i] = decompose(glm::affineInverse(above) * glm::affineInverse(bone_of[i]->inverse_bind));
    world[i] = above * local_matrix(rig, pose, static_cast<int>(i));
  }
  return pose;
}

Pose sample_clip(const Rig& rig, const Clip& clip, double time) {
  Pose pose = bind_pose(rig);
  for (const Channel& channel : clip.channels) {
    if (channel.times.empty()) continue;
    if (channel.path == ChannelPath::weights) {
      const std::size_t stride = channel.values.size() / channel.times.size();
      const std::size_t width = channel.interpolation == Interpolation::cubic_spline ? stride / 3 : stride;
      const std::vector<double> weights = sample_channel(channel, time, width);
      if (pose.morph_weights.empty()) pose.morph_weights = rig.morph_weights;
      for (std::size_t slot = 0; slot < rig.morph_weights.size(); ++slot)
        if (rig.morph_node[slot] == channel.node && rig.morph_index[slot] < static_cast<int>(weights.size()))
          pose.morph_weights[slot] = weights[rig.morph_index[slot]];
      continue;
    }
    if (!pose.local[channel.node]) pose.local[channel.node] = local_transform(rig, pose, channel.node);
    LocalTransform& local = *pose.local[channel.node];
    const std::vector<double> v = sample_channel(channel, time, channel.path == ChannelPath::rotation ? 4 : 3);
    if (channel.path == ChannelPath::translation) local.translation = {v[0], v[1], v[2]};
    if (channel.path == ChannelPath::scale) local.scale = {v[0], v[1], v[2]};
    if (channel.path == ChannelPath::rotation) local.rotation = unit(quat_at(v.data()));
  }
  return pose;
}

std::vector<dmat4> world_transforms(const Rig& rig, const Pose& pose) {
  check(pose.local.size() == rig.nodes.size(), "the pose belongs to another rig");
  std::vector<dmat4> world(rig.nodes.size());
  for (std::size_t i = 0; i < rig.nodes.size(); ++i) {
    const int parent = rig.nodes[i].parent;
    check(parent < static_cast<int>(i), "nodes are not sorted parents first");
    world[i] = (parent < 0 ? pose.placement : world[parent]) * local_matrix(rig, pose, static_cast<int>(i));
  }
  return world;
}

std::vector<dmat4> bone_matrices(const Rig& rig, const std::vector<dmat4>& world) {
  std::vector<dmat4> bones;
  bones.reserve(rig.bones.size());
  for (const Bone& bone : rig.bones) bones.push_back(world[bone.node] * bone.inverse_bind);
  return bones;
}

}  // namespace moomill
