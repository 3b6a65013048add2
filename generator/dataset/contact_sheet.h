#pragma once
// Pictures of a dataset for the human eye: all views of a frame, and all modalities of a view.
#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "generator/core/image.h"
#include "generator/dataset/dataset.h"

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

// What the sheets are made of, for other sheets. Keypoints of one animal and the skeleton's edges, onto a picture whose
// pixels are 1 / scale of the view's; pictures in rows with a label below each and a title above.
void draw_keypoints(Image8& image, const Manifest& m, const View& view, int animal, double scale);
Image8 picture_grid(const std::vector<Image8>& cells, const std::vector<std::string>& labels, int columns,
                    const std::string& title);
// Distinct colours for small integers, hues a golden ratio apart; 0 is black.
std::array<std::uint8_t, 3> color_of_id(std::uint32_t id);

}  // namespace moomill
