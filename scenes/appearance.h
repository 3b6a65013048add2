#pragma once
// Finishes and coats of the animals of a scene, decoded and baked as far as they are asked for.
#include <memory>
#include <vector>

#include "generator/render/scene.h"
#include "scenes/runner.h"

namespace moomill {

// Holds what all coats share, and dresses the animals in one batch of coats after the other. Batches are runs of the
// scene's chosen coats. Of render.memory_mb, two batches at work take at most a quarter, the pictures of two views in
// the making half, and a quarter is for batches that are kept: the first ones, as many as fit; later ones are baked
// again whenever they are asked for. None of this changes a bit of any picture.
class Wardrobe {
 public:
  // `species`: per animal. With light: coats and finishes; without: only what cuts holes into surfaces.
  Wardrobe(const SceneSpec& scene, const std::vector<const Species*>& species, bool with_light, StageCounts& counts);
  ~Wardrobe();

  // What every batch has in common: materials without coats, for all that needs no light.
  const std::shared_ptr<const Appearance>& bare() const { return bare_; }
  const std::vector<std::vector<int>>& materials() const { return materials_; }  // per animal: the rig's, in the appearance
  int ground_material() const { return ground_material_; }

  int batches() const { return static_cast<int>(batches_.size()); }      // 0 without light
  const std::vector<int>& batch(int b) const { return batches_[b]; }     // coat indices
  std::shared_ptr<const Appearance> dress(int b) const;                   // thread-safe

 private:
  struct State;
  std::vector<std::vector<int>> batches_;
  std::shared_ptr<const Appearance> bare_;
  std::vector<std::vector<int>> materials_;
  int ground_material_ = -1;
  std::unique_ptr<State> state_;
};

// Coats of a batch, baked batches that are kept, and the bytes that follow.
struct BatchPlan {
  int coats = most_coats, kept = 1;
  double bytes = 0;
};
// 128 coats are shaded at once (32 with render.surface_light), fewer where they would pass an eighth of the memory or their pictures of
// one view a quarter.
// InputError where not even one coat fits.
BatchPlan plan_batches(const SceneSpec& scene);

}  // namespace moomill
