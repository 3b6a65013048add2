#pragma once
// glTF is Y up, we are Z up: (x, y, z) -> (x, -z, y) and back. Permutations and signs only, so values stay exact.
#include "rigs/rig.h"

namespace moomill::gltf {

template <class V>
V to_z_up(const V& v) {
  return V(v.x, -v.z, v.y);
}
template <class V>
V to_y_up(const V& v) {
  return V(v.x, v.z, -v.y);
}
inline dquat to_z_up(const dquat& q) {
  return dquat(q.w, q.x, -q.z, q.y);
}
inline dquat to_y_up(const dquat& q) {
  return dquat(q.w, q.x, q.z, -q.y);
}
inline dvec3 swap_scale(const dvec3& s) {
  return dvec3(s.x, s.z, s.y);
}  // its own inverse

// P m P^-1 for the permutation that takes row/column i from `from[i]` with sign[i].
inline dmat4 conjugate(const dmat4& m, const int (&from)[4], const double (&sign)[4]) {
  dmat4 r(0.0);
  for (int column = 0; column < 4; ++column)
    for (int row = 0; row < 4; ++row) r[column][row] = sign[row] * sign[column] * m[from[column]][from[row]];
  return r;
}
inline dmat4 to_z_up(const dmat4& m) {
  return conjugate(m, {0, 2, 1, 3}, {1, -1, 1, 1});
}
inline dmat4 to_y_up(const dmat4& m) {
  return conjugate(m, {0, 2, 1, 3}, {1, 1, -1, 1});
}

}  // namespace moomill::gltf
