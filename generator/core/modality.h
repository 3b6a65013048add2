#pragma once
// The one table of what moomill can write about a view. Writers, manifest, plan, tests and docs iterate it.
//
// To add a modality:
//   1. add a value to Modality and a row to modality_table() in modality.cpp (same order);
//   2. fill its map in generator/render/labels.cpp (labels) or scenes/runner.cpp (anything else);
//   3. nothing else: file names, the manifest entry, `plan`, `--modalities` and the layer names of `render` follow
//      from the row; tests/scenes/modalities.cpp checks every row.
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "generator/core/image.h"
#include "generator/core/math.h"

namespace moomill {

enum class Modality : std::uint8_t {
  rgb,
  silhouette,
  coverage,
  depth,
  nnopcs,
  normal,
  uv,
  part,
  instance,
  triangle,
  keypoints,
  occlusion,
  count,
};

enum class Storage : std::uint8_t {
  jpeg8,    // 8-bit sRGB JPEG, quality 95, no chroma subsampling (alpha is composited away)
  png8,     // 8-bit PNG, the integer itself (labels) or value * 255 rounded (coverage)
  png16,    // 16-bit PNG, the integer itself
  exr32,    // float32 EXR
  exr_ids,  // EXR: uint32 channel "id", float32 channels "u", "v"
  record,   // in the per-frame record, no file of its own
};

struct ModalityRow {
  Modality id;
  const char* name;        // as in scene files, folders, manifests and EXR layers
  int channels;            // values per pixel
  Storage storage;
  const char* unit;
  double background;       // value where no animal is
  bool needs_light;        // wants lights, coats and path tracing
  bool needs_first_hit;    // wants the pixel-centre rays
  bool needs_uv;           // wants UVs
  bool per_coat;           // one file per coat
  const char* about;       // one line of documentation
};

std::span<const ModalityRow> modality_table();
const ModalityRow& row(Modality m);
std::optional<Modality> modality_from_name(std::string_view name);
const char* extension(Storage storage);  // ".jpg", ".png", ".exr" or ""

// A set of modalities.
struct ModalitySet {
  std::uint32_t bits = 0;
  bool has(Modality m) const { return bits >> static_cast<int>(m) & 1u; }
  void add(Modality m) { bits |= 1u << static_cast<int>(m); }
  bool any(bool ModalityRow::*need) const;
};

// One modality of one view. Float modalities fill `f`, integer ones `u`; `triangle` fills both (u: id, f: barycentrics).
struct Map {
  Modality modality{};
  int coat = -1;    // for per-coat modalities, else -1
  int animal = -1;  // for the whole masks of `occlusion`, else -1
  ImageF f;         // rgb: linear Rec. 709, 4 channels, premultiplied alpha
  ImageU32 u;
};

enum class Visibility : std::uint8_t { off_frame = 0, hidden = 1, visible = 2 };  // as in COCO
enum class HiddenBy : std::uint8_t { nothing, self, other_animal, scenery, off_frame };

// A keypoint in one view.
struct KeypointView {
  dvec2 pixel{0};     // pixels; pixel (i, j) has its centre at (i + 0.5, j + 0.5)
  double depth = 0;   // metres, camera z; <= 0 behind the camera
  Visibility visibility = Visibility::off_frame;
  HiddenBy cause = HiddenBy::off_frame;
  int occluder = -1;  // animal that hides it when cause is other_animal
  double margin = 0;  // metres behind the nearest surface along the ray; negative in front of it; 0 when nothing is hit
};

// How much of one animal is hidden in one view; all from the pixel-centre rays.
struct OcclusionView {
  std::uint64_t whole_pixels = 0, visible_pixels = 0;
  double hidden_fraction = 0;           // 1 - visible / whole; 0 when whole is 0
  std::vector<std::uint64_t> occluded;  // per animal: pixels of this animal that it hides
};

// All that was computed of one view.
struct View {
  double samples = 0;  // a pixel that may see anything, of the pictures; not written
  int frame = 0, camera = 0;  // as numbered in the dataset
  int width = 0, height = 0;
  vec3 background{0};         // linear colour that 8-bit colour files show where alpha is below 1
  std::vector<Map> maps;
  std::vector<std::vector<KeypointView>> keypoints;  // per animal, per keypoint
  std::vector<OcclusionView> occlusion;              // per animal
  const Map* find(Modality m, int coat = -1, int animal = -1) const;
};

}  // namespace moomill
