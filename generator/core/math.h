#pragma once
// Vectors and matrices (GLM) and the few helpers everything shares. Doubles for transforms, floats for vertices.
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>
#include <glm/mat3x4.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>

namespace moomill {

using glm::dmat3;
using glm::dmat4;
using glm::dquat;
using glm::dvec2;
using glm::dvec3;
using glm::dvec4;
using glm::uvec3;
using glm::vec2;
using glm::vec3;
using glm::vec4;

inline constexpr double pi = std::numbers::pi;
inline constexpr double degrees = pi / 180.0;  // 30 * degrees is in radians

template <class V>
bool all_finite(const V& v) {
  for (int i = 0; i < V::length(); ++i)
    if (!std::isfinite(v[i])) return false;
  return true;
}

// Axis-aligned box; empty (lower > upper) by default.
struct Box {
  dvec3 lower{std::numeric_limits<double>::infinity()};
  dvec3 upper{-std::numeric_limits<double>::infinity()};
  void add(const dvec3& p) {
    lower = glm::min(lower, p);
    upper = glm::max(upper, p);
  }
  bool empty() const { return !(lower.x <= upper.x && lower.y <= upper.y && lower.z <= upper.z); }
  dvec3 size() const { return upper - lower; }
  dvec3 centre() const { return 0.5 * (lower + upper); }
  double diagonal() const { return glm::length(size()); }
};

inline dvec3 transform_point(const dmat4& m, const dvec3& p) { return dvec3(m * dvec4(p, 1.0)); }
inline dvec3 transform_vector(const dmat4& m, const dvec3& v) { return dvec3(m * dvec4(v, 0.0)); }

}  // namespace moomill
