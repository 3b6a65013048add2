#include "generator/core/surface.h"

#include "generator/core/error.h"

namespace moomill {
namespace {

// x -> x * scale + shift takes metres to [0, 1]. A flat box axis maps to 0.5 (box) so that it stays invertible.
struct Normalizer {
  dvec3 scale{1}, shift{0};
};

Normalizer normalizer(const Box& box, NnopcsNormalization normalization) {
  Normalizer n;
  if (normalization == NnopcsNormalization::diagonal) {
    const double d = box.diagonal();
    n.scale = dvec3(d > 0 ? 1.0 / d : 1.0);
    n.shift = dvec3(0.5) - box.centre() * n.scale;
    return n;
  }
  const dvec3 size = box.size();
  for (int i = 0; i < 3; ++i) {
    n.scale[i] = size[i] > 0 ? 1.0 / size[i] : 1.0;
    n.shift[i] = size[i] > 0 ? -box.lower[i] * n.scale[i] : 0.5 - box.lower[i];
  }
  return n;
}

}  // namespace

void bake_nnopcs(Surface& surface, const std::vector<vec3>& neutral, NnopcsNormalization normalization) {
  check(neutral.size() == surface.rest.size(), "the neutral pose has another number of vertices");
  surface.neutral_box = Box{};
  surface.normalization = normalization;
  // Only vertices that a triangle uses: a stray vertex must not stretch the box.
  for (const uvec3& t : surface.triangles)
    for (int k = 0; k < 3; ++k) surface.neutral_box.add(dvec3(neutral[t[k]]));
  if (surface.neutral_box.empty()) surface.neutral_box = Box{dvec3(0), dvec3(0)};
  const Normalizer n = normalizer(surface.neutral_box, normalization);
  surface.nnopcs.resize(neutral.size());
  for (std::size_t i = 0; i < neutral.size(); ++i)
    surface.nnopcs[i] = vec3(glm::clamp(dvec3(neutral[i]) * n.scale + n.shift, dvec3(0.0), dvec3(1.0)));
}

dvec3 nnopcs_to_metres(const Surface& surface, const dvec3& nnopcs) {
  const Normalizer n = normalizer(surface.neutral_box, surface.normalization);
  return (nnopcs - n.shift) / n.scale;
}

}  // namespace moomill
