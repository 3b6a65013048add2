#include "rigs/loading.h"

#include "generator/core/error.h"
#include "rigs/pose.h"

namespace moomill {

double largest_difference(const dmat4& a, const dmat4& b) {
  double most = 0;
  for (int c = 0; c < 4; ++c)
    for (int r = 0; r < 4; ++r) most = std::max(most, std::abs(a[c][r] - b[c][r]));
  return most;
}

bool is_invertible(const dmat4& m) {
  for (int c = 0; c < 4; ++c)
    if (!all_finite(m[c])) return false;
  const double size = std::max({glm::length(m[0]), glm::length(m[1]), glm::length(m[2])});
  return std::abs(glm::determinant(dmat3(m))) > 1e-12 * size * size * size;
}

dmat4 skin_space(const dmat4& joint, const dmat4& inverse_bind, std::vector<std::string>& warnings) {
  const dmat4 to_model = joint * inverse_bind;
  if (!is_invertible(to_model)) {
    warnings.push_back("a skin has a flat bind matrix, its vertices stay in their own space");
    return dmat4(1.0);
  }
  return largest_difference(to_model, dmat4(1.0)) < 1e-5 ? dmat4(1.0) : to_model;
}

void set_transform(Node& node, const dmat4& matrix, double relative_error) {
  const LocalTransform local = decompose(matrix);
  node.translation = local.translation;
  node.rotation = local.rotation;
  node.scale = local.scale;
  const double size = largest_difference(matrix, dmat4(0.0));
  if (!(largest_difference(compose(local), matrix) <= relative_error * size)) node.matrix = matrix;
}

bool MeshChoice::takes(const std::string& node, const std::string& mesh, bool skinned) {
  known_.push_back(node);
  if (mesh != node) known_.push_back(mesh);
  const auto& wanted = options_.include_meshes;
  const auto asked = [&](const std::string& name) {
    return std::find(wanted.begin(), wanted.end(), name) != wanted.end();
  };
  const bool take = wanted.empty() ? skinned || !any_skinned_ : asked(node) || asked(mesh);
  left_out_ += !take;
  return take;
}

void MeshChoice::finish(Rig& rig) const {
  for (const std::string& name : options_.include_meshes)
    if (std::find(known_.begin(), known_.end(), name) == known_.end()) {
      std::string names;
      for (const std::string& k : known_)
        if (!k.empty()) names += (names.empty() ? "'" : ", '") + k + "'";
      input_error("{}: has no mesh '{}', only {}", rig.source, name, names.empty() ? "none at all" : names);
    }
  if (left_out_ && options_.include_meshes.empty())
    rig.warnings.push_back(fmt::format("{} meshes without skin were left out, name them to have them", left_out_));
}

}  // namespace moomill
