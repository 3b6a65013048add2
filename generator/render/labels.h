#pragma once
// Labels of a view: everything that the pixel-centre rays and single traced rays say. Never filtered.
#include <vector>

#include "generator/core/modality.h"
#include "generator/render/first_hit.h"

namespace moomill {

struct LabelRequest {
  ModalitySet modalities;
  int only_animal = -1;  // labels of this animal alone (`instance` still shows all); -1: of every animal
};

// Appends to view.maps one map for each requested per-pixel label modality (not rgb, coverage, keypoints, occlusion).
void add_labels(View& view, const Scene& scene, const FirstHits& hits, const LabelRequest& request);

// Share of each pixel's area that the animals cover, by stratified rays on outline pixels alone; the other pixels are
// covered wholly or not at all.
ImageF trace_coverage(const Scene& scene, const Accel& accel, const Camera& camera, const FirstHits& hits, std::uint64_t stream);

// Appends the whole mask of every animal to view.maps and fills view.occlusion. One more ray per animal and pixel,
// only where another animal could hide it.
void add_occlusion(View& view, const Scene& scene, const Accel& accel, const Camera& camera, const FirstHits& hits);

struct KeypointQuery {
  dvec3 position{0};     // metres, world
  double tolerance = 0;  // metres it may lie behind the visible surface
};
// Where a keypoint of `animal` appears in the view, and whether it is seen.
KeypointView trace_keypoint(const Scene& scene, const Accel& accel, const Camera& camera, int animal, const KeypointQuery& q);

}  // namespace moomill
