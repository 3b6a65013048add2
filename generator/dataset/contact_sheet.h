#pragma once
// Pictures of a dataset for the human eye: all views of a frame, and all modalities of a view.
#include <filesystem>
#include <optional>

#include "generator/core/image.h"

namespace moomill {

struct ContactSheetOptions {
  std::optional<int> frame;   // default: the first the dataset holds
  std::optional<int> camera;  // of modality_sheet(); default: the first
  std::optional<int> coat;    // default: the first the dataset holds
  int columns = 8;            // cameras a row: a ring
  int thumbnail_width = 256;  // pixels
  bool keypoints = true;
};

// All views of one frame with keypoints (filled: visible, hollow: hidden; blue: left, red: right, yellow: neither)
// and skeleton edges. Shows colour where the dataset has it, else NNOPCS, depth or the silhouette.
Image8 contact_sheet(const std::filesystem::path& dataset, const ContactSheetOptions& options = {});

// One view in every modality: depth and ids in false colours, NNOPCS and normals as RGB.
Image8 modality_sheet(const std::filesystem::path& dataset, const ContactSheetOptions& options = {});

}  // namespace moomill
