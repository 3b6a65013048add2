#include <glm/gtc/matrix_inverse.hpp>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "rigs/pose.h"

namespace moomill {
namespace {

constexpr std::size_t chunk =
    2048;  // vertices a task does; fixed, and each vertex is its own sum, so threads do not matter

// The upper three rows of an affine matrix, column after column: twelve doubles that blend in three AVX operations.
struct alignas(32) Affine {
  double m[12] = {};

  Affine() = default;
  explicit Affine(const dmat4& matrix) {
    for (int column = 0; column < 4; ++column)
      for (int row = 0; row < 3; ++row) m[3 * column + row] = matrix[column][row];
  }
  void add(double weight, const Affine& other) {
    for (int i = 0; i < 12; ++i) m[i] += weight * other.m[i];
  }
  dvec3 column(int i) const { return {m[3 * i], m[3 * i + 1], m[3 * i + 2]}; }
  dvec3 vector(const dvec3& v) const { return column(0) * v.x + column(1) * v.y + column(2) * v.z; }
  dvec3 point(const dvec3& p) const { return vector(p) + column(3); }
};

bool normalize_to(const dvec3& v, dvec3& unit) {
  const double squared = glm::dot(v, v);
  if (!(squared > 1e-60) || !std::isfinite(squared)) return false;
  unit = v / std::sqrt(squared);
  return true;
}

// Direction of a normal under m: by the inverse transpose, as cofactors times the sign of the determinant, which
// stays defined where a direction is flattened. Where two are, m itself; where all are, the normal as it was.
dvec3 transform_normal(const Affine& m, const dvec3& normal) {
  const dvec3 a = m.column(0), b = m.column(1), c = m.column(2);
  const dvec3 bc = glm::cross(b, c);
  const double sign = glm::dot(a, bc) < 0 ? -1.0 : 1.0;
  dvec3 result = normal;
  if (normalize_to(sign * (bc * normal.x + glm::cross(c, a) * normal.y + glm::cross(a, b) * normal.z), result))
    return result;
  normalize_to(m.vector(normal), result);
  return result;
}

// Rest positions and normals with the morph targets added.
struct Rest {
  const Rig& rig;
  std::vector<dvec3> positions, normals;  // empty: no morph target is active

  Rest(const Rig& r, const std::vector<double>& given) : rig(r) {
    const std::vector<double>& weights = given.empty() ? rig.morph_weights : given;
    check(weights.size() == rig.morph_weights.size(), "the number of morph weights is another");
    for (const MorphTarget& morph : rig.morphs) {
      const double weight = weights[morph.weight_slot];
      if (weight == 0) continue;
      if (positions.empty()) {
        positions.assign(rig.surface.rest.begin(), rig.surface.rest.end());
        normals.assign(rig.surface.normals.begin(), rig.surface.normals.end());
      }
      parallel_for(morph.positions.size(), chunk, [&](std::size_t i) {
        positions[morph.first_vertex + i] += weight * dvec3(morph.positions[i]);
        if (!morph.normals.empty()) normals[morph.first_vertex + i] += weight * dvec3(morph.normals[i]);
      });
    }
  }
  dvec3 position(std::size_t v) const { return positions.empty() ? dvec3(rig.surface.rest[v]) : positions[v]; }
  dvec3 normal(std::size_t v) const { return normals.empty() ? dvec3(rig.surface.normals[v]) : normals[v]; }
};

// Calls body(vertex, influences, count, 1 / sum of weights) for every vertex, in parallel. The weights sum to 1 but for
// float rounding; dividing by their sum keeps that rounding from growing with the distance to the origin.
template <class Body>
void for_each_vertex(const Rig& rig, const Body& body) {
  const std::size_t vertices = rig.surface.rest.size(), chunks = (vertices + chunk - 1) / chunk;
  parallel_for(chunks, 1, [&](std::size_t c) {
    for (std::size_t v = c * chunk; v < std::min(vertices, (c + 1) * chunk); ++v) {
      const Influence* first = rig.influences.data() + rig.influence_begin[v];
      const std::uint32_t count = rig.influence_begin[v + 1] - rig.influence_begin[v];
      double sum = 0;
      for (std::uint32_t i = 0; i < count; ++i) sum += first[i].weight;
      body(v, first, count, 1.0 / sum);
    }
  });
}

void skin_linear(const Rig& rig, const std::vector<Affine>& bones, const Rest& rest, PosedSurface& posed) {
  for_each_vertex(rig, [&](std::size_t v, const Influence* influence, std::uint32_t count, double inverse_sum) {
    Affine blend;
    for (std::uint32_t i = 0; i < count; ++i) blend.add(influence[i].weight * inverse_sum, bones[influence[i].bone]);
    posed.positions[v] = vec3(blend.point(rest.position(v)));
    posed.normals[v] = vec3(transform_normal(blend, rest.normal(v)));
  });
}

// A bone matrix as a rigid motion after a stretch: B = rigid * stretch. The stretch leaves the joint's place in the
// bind pose fixed, so that scaling a bone does not shift the centre that blended rotations turn about.
struct DualQuaternion {
  alignas(32) double q[8] = {};  // real w, x, y, z, dual w, x, y, z: they blend in two AVX operations
  Affine stretch;
  bool rigid = true;
};

// The rotation that is left of an orthogonal matrix that mirrors, without its mirror: along the axis that it turns about (its
// eigenvector of -1), so that a bone mirrored on one axis has not turned at all.
dmat3 without_mirror(const dmat3& q) {
  const dmat3 rows = glm::transpose(q + dmat3(1.0));  // the axis is what they leave at zero
  dvec3 axis(0);
  for (int i = 0; i < 3; ++i) {
    const dvec3 across = glm::cross(rows[i], rows[(i + 1) % 3]);
    if (glm::dot(across, across) > glm::dot(axis, axis)) axis = across;
  }
  const double length = glm::length(axis);
  axis = length > 1e-9 ? axis / length : dvec3(1, 0, 0);  // mirrored through a point: any axis will do
  return q * (dmat3(1.0) - 2.0 * glm::outerProduct(axis, axis));
}

// Rotation of the polar decomposition, by Newton's iteration (Higham 1986); Gram-Schmidt where that does not exist.
dmat3 nearest_rotation(const dmat3& m) {
  double size = 0;
  for (int i = 0; i < 3; ++i) size = std::max(size, glm::length(m[i]));
  dmat3 x = m;
  const double determinant = glm::determinant(m);
  if (std::abs(determinant) > 1e-9 * size * size * size && std::isfinite(determinant)) {
    for (int i = 0; i < 60; ++i) {
      const dmat3 next = 0.5 * (x + glm::transpose(glm::inverse(x)));
      double change = 0;
      for (int c = 0; c < 3; ++c) change = std::max(change, glm::length(next[c] - x[c]));
      x = next;
      if (change < 1e-15) break;
    }
    if (determinant < 0) x = without_mirror(x);
    return x;
  }
  dmat4 affine(m);
  affine[3] = dvec4(0, 0, 0, 1);
  return glm::mat3_cast(decompose(affine).rotation);
}

DualQuaternion dual_quaternion(const dmat4& bone, const dmat4& inverse_bind) {
  DualQuaternion result;
  const dmat3 linear(bone);
  const dmat3 rotation = nearest_rotation(linear);
  const dmat3 stretch = glm::transpose(rotation) * linear;
  dvec3 joint(0);
  if (std::abs(glm::determinant(dmat3(inverse_bind))) > 1e-30) joint = dvec3(glm::affineInverse(inverse_bind)[3]);
  dmat4 about_joint(stretch);
  about_joint[3] = dvec4(joint - stretch * joint, 1);
  result.stretch = Affine(about_joint);
  double off = 0;
  for (int i = 0; i < 3; ++i) off = std::max(off, glm::length(stretch[i] - dmat3(1.0)[i]));
  result.rigid = off < 1e-9;
  const dvec3 translation = dvec3(bone[3]) - rotation * dvec3(about_joint[3]);
  const dquat real = glm::normalize(glm::quat_cast(rotation));
  const dquat dual = 0.5 * (dquat(0, translation.x, translation.y, translation.z) * real);
  const double parts[8] = {real.w, real.x, real.y, real.z, dual.w, dual.x, dual.y, dual.z};
  std::copy(parts, parts + 8, result.q);
  return result;
}

void skin_dual_quaternion(const Rig& rig, const std::vector<DualQuaternion>& bones, const Rest& rest,
                          PosedSurface& posed) {
  bool rigid = true;
  for (const DualQuaternion& bone : bones) rigid &= bone.rigid;
  for_each_vertex(rig, [&](std::size_t v, const Influence* influence, std::uint32_t count, double inverse_sum) {
    std::uint32_t pivot = 0;
    for (std::uint32_t i = 1; i < count; ++i)
      if (influence[i].weight > influence[pivot].weight) pivot = i;
    const double* reference = bones[influence[pivot].bone].q;
    alignas(32) double blend[8] = {};
    Affine stretch;
    for (std::uint32_t i = 0; i < count; ++i) {
      const DualQuaternion& bone = bones[influence[i].bone];
      const double weight = influence[i].weight * inverse_sum;
      // q and -q are the same rotation: take the one on the side of the vertex's strongest bone.
      double cosine = 0;
      for (int k = 0; k < 4; ++k) cosine += bone.q[k] * reference[k];
      const double signed_weight = cosine < 0 ? -weight : weight;
      for (int k = 0; k < 8; ++k) blend[k] += signed_weight * bone.q[k];
      if (!rigid) stretch.add(weight, bone.stretch);
    }
    double squared = 0;
    for (int k = 0; k < 4; ++k) squared += blend[k] * blend[k];
    const double inverse_length = 1 / std::sqrt(squared);
    for (double& x : blend) x *= inverse_length;
    dvec3 position = rest.position(v), normal = rest.normal(v);
    if (!rigid) {
      position = stretch.point(position);
      normal = transform_normal(stretch, normal);
    }
    const double w = blend[0], dual_w = blend[4];
    const dvec3 axis(blend[1], blend[2], blend[3]), dual(blend[5], blend[6], blend[7]);
    const auto rotate = [&](const dvec3& p) { return p + 2.0 * glm::cross(axis, glm::cross(axis, p) + w * p); };
    const dvec3 translation = 2.0 * (w * dual - dual_w * axis + glm::cross(axis, dual));
    posed.positions[v] = vec3(rotate(position) + translation);
    dvec3 unit = normal;
    normalize_to(rotate(normal), unit);
    posed.normals[v] = vec3(unit);
  });
}

}  // namespace

PosedSurface skin(const Rig& rig, const std::vector<dmat4>& bones, const std::vector<double>& morph_weights,
                  SkinningMethod method, const dvec3& origin) {
  const std::size_t vertices = rig.surface.rest.size();
  check(bones.size() == rig.bones.size(), "as many matrices as bones are needed");
  check(rig.influence_begin.size() == vertices + 1 && rig.surface.normals.size() == vertices,
        "the rig was not finished by finish_rig()");
  PosedSurface posed;
  posed.origin = origin;
  posed.positions.resize(vertices);
  posed.normals.resize(vertices);
  const Rest rest(rig, morph_weights);
  // The origin goes into the matrices, in double: positions are then small numbers from the start.
  std::vector<dmat4> relative = bones;
  for (dmat4& bone : relative) bone[3] -= dvec4(origin, 0);
  if (method == SkinningMethod::linear_blend) {
    skin_linear(rig, {relative.begin(), relative.end()}, rest, posed);
  } else {
    std::vector<DualQuaternion> motions;
    motions.reserve(bones.size());
    for (std::size_t i = 0; i < bones.size(); ++i)
      motions.push_back(dual_quaternion(relative[i], rig.bones[i].inverse_bind));
    skin_dual_quaternion(rig, motions, rest, posed);
  }
  return posed;
}

}  // namespace moomill
