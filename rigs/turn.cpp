// Turning a whole rig about the vertical axis.
#include "rigs/rig.h"

namespace moomill {

void turn_rig(Rig& rig, double yaw_deg) {
  const dquat turn = glm::angleAxis(yaw_deg * degrees, dvec3(0, 0, 1));
  const dmat4 matrix = glm::mat4_cast(turn), back = glm::mat4_cast(glm::conjugate(turn));
  const auto turned = [&](const vec3& v) { return vec3(turn * dvec3(v)); };
  for (vec3& p : rig.surface.rest) p = turned(p);
  for (vec3& n : rig.surface.normals) n = turned(n);
  for (MorphTarget& m : rig.morphs) {
    for (vec3& p : m.positions) p = turned(p);
    for (vec3& n : m.normals) n = turned(n);
  }
  for (Bone& b : rig.bones) b.inverse_bind = b.inverse_bind * back;
  for (Node& n : rig.nodes) {
    if (n.parent >= 0) continue;
    n.translation = turn * n.translation;
    n.rotation = turn * n.rotation;
    if (n.matrix) n.matrix = matrix * *n.matrix;
  }
  // What moves a topmost node moves in the turned space too. Both maps are linear, so tangents turn like values.
  for (Clip& clip : rig.clips)
    for (Channel& c : clip.channels) {
      if (rig.nodes[c.node].parent >= 0) continue;
      std::vector<double>& v = c.values;
      if (c.path == ChannelPath::translation)
        for (std::size_t i = 0; i + 2 < v.size(); i += 3) {
          const dvec3 t = turn * dvec3(v[i], v[i + 1], v[i + 2]);
          for (int k = 0; k < 3; ++k) v[i + k] = t[k];
        }
      if (c.path == ChannelPath::rotation)
        for (std::size_t i = 0; i + 3 < v.size(); i += 4) {
          const dquat q = turn * dquat(v[i + 3], v[i], v[i + 1], v[i + 2]);
          v[i] = q.x, v[i + 1] = q.y, v[i + 2] = q.z, v[i + 3] = q.w;
        }
    }
}

}  // namespace moomill
