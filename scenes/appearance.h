#pragma once
// Finishes and coats of the animals of a scene, decoded and baked as far as they are asked for.
#include <memory>
#include <vector>

#include "generator/render/scene.h"
#include "scenes/runner.h"

namespace moomill {

struct BuiltAppearance {
  std::shared_ptr<Appearance> appearance;
  std::vector<std::vector<int>> materials;  // per animal: the rig's materials in the appearance
  int ground_material = -1;
};

// `species`: per animal. With light: coats and finishes; without: only what cuts holes into surfaces.
BuiltAppearance build_appearance(const SceneSpec& scene, const std::vector<const Species*>& species, bool with_light,
                                 StageCounts& counts);

}  // namespace moomill
