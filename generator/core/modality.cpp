#include "generator/core/modality.h"

#include "generator/core/error.h"

namespace moomill {
namespace {

using enum Modality;
using enum Storage;

constexpr ModalityRow table[] = {
    // id, name, channels, storage, unit, background, light, first hit, uv, per coat, about
    {rgb, "rgb", 4, jpeg8, "linear Rec. 709", 0, true, false, true, true, "path-traced colour, filtered over the pixel"},
    {silhouette, "silhouette", 1, png8, "0 or 255", 0, false, true, false, false, "255 where the pixel-centre ray meets the animal"},
    {coverage, "coverage", 1, png8, "fraction", 0, false, false, false, false, "share of the pixel that the animal covers, antialiased"},
    {depth, "depth", 1, exr32, "m", 0, false, true, false, false, "camera z at the pixel centre"},
    {nnopcs, "nnopcs", 3, exr32, "[0, 1]", 0, false, true, false, false, "normalised coordinates of the surface point in the neutral pose"},
    {normal, "normal", 3, exr32, "unit vector, world", 0, false, true, false, false, "shading normal at the pixel centre"},
    {uv, "uv", 2, exr32, "[0, 1]", -1, false, true, true, false, "texture coordinates, (0, 0) at the top left"},
    {part, "part", 1, png16, "1 + part index", 0, false, true, false, false, "body part; names are in the manifest"},
    {instance, "instance", 1, png8, "1 + animal index", 0, false, true, false, false, "which animal"},
    {triangle, "triangle", 3, exr_ids, "1 + triangle index, barycentrics of its 2nd and 3rd vertex", 0, false, true, false, false,
     "triangle and barycentrics: the exact surface point"},
    {keypoints, "keypoints", 0, record, "m, px", 0, false, false, false, false, "3D and 2D keypoints with visibility, cause and margin"},
    {occlusion, "occlusion", 1, png8, "0 or 255", 0, false, true, false, false, "whole mask of every animal, occluders and hidden fractions"},
};
static_assert(std::size(table) == static_cast<std::size_t>(Modality::count));

}  // namespace

std::span<const ModalityRow> modality_table() { return table; }

const ModalityRow& row(Modality m) {
  check(m < Modality::count, "modality out of range");
  return table[static_cast<int>(m)];
}

std::optional<Modality> modality_from_name(std::string_view name) {
  for (const ModalityRow& r : table)
    if (name == r.name) return r.id;
  return std::nullopt;
}

const char* extension(Storage storage) {
  switch (storage) {
    case jpeg8: return ".jpg";
    case png8:
    case png16: return ".png";
    case exr32:
    case exr_ids: return ".exr";
    case record: return "";
  }
  return "";
}

bool ModalitySet::any(bool ModalityRow::*need) const {
  for (const ModalityRow& r : table)
    if (has(r.id) && r.*need) return true;
  return false;
}

const Map* View::find(Modality m, int coat, int animal) const {
  for (const Map& map : maps)
    if (map.modality == m && map.coat == coat && map.animal == animal) return &map;
  return nullptr;
}

}  // namespace moomill
