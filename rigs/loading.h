#pragma once
// What the loaders share. Not for others.
#include "rigs/rig.h"

namespace moomill {

double largest_difference(const dmat4& a, const dmat4& b);
bool is_invertible(const dmat4& m);

// Skinned vertices come in a space of their own, which joint * inverse_bind takes to model space, equally for every
// joint where the file is posed as it was bound. The loaders move that common matrix from the inverse bind matrices
// into the vertices, so that rest positions are in model space and metres; no posed vertex changes by it. This is the
// matrix, given the joint nearest to the root (poses seldom move it); exactly the identity where the spaces agree.
dmat4 skin_space(const dmat4& joint, const dmat4& inverse_bind, std::vector<std::string>& warnings);

// Keeps decomposed parts where they express the matrix within the relative error, else the matrix.
void set_transform(Node& node, const dmat4& matrix, double relative_error);

// The skinned meshes where there are any, else all; or those whose name (either of two) is asked for.
class MeshChoice {
 public:
  MeshChoice(const LoadOptions& options, bool any_skinned) : options_(options), any_skinned_(any_skinned) {}
  bool takes(const std::string& node, const std::string& mesh, bool skinned);
  // Throws InputError where a name was asked for in vain; else says what was left out.
  void finish(Rig& rig) const;

 private:
  const LoadOptions& options_;
  bool any_skinned_;
  std::size_t left_out_ = 0;
  std::vector<std::string> known_;
};

}  // namespace moomill
