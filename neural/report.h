#pragma once
// What evaluations leave behind: named figures with units as summary.json (the format of every study of moomill),
// Markdown tables, and tensors as pictures.
#include <torch/torch.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "generator/core/image.h"
#include "neural/metrics.h"

namespace moomill {

// One measured number, and the bound it is held against, where there is one.
struct Measure {
  std::string name;
  double value = 0;
  std::string unit;  // "mm"; empty for a ratio
  std::optional<double> at_most, at_least;
  bool holds() const;  // not-a-number never does
};

// {"title", "figures": [{name, value, unit, at_most?, at_least?, holds}]}; not-a-number becomes null.
std::string summary_json(const std::string& title, const std::vector<Measure>& measures);
// Not-a-number becomes null.
nlohmann::json number_json(double value);
// Digits for people: three significant ones at least, "-" for not-a-number.
std::string figure_text(double value, int decimals);

// [3, h, w] in [0, 1], or [h, w] as grey, clamped and rounded to 8 bits RGB.
Image8 picture_of(const torch::Tensor& image);
// 8-bit NNOPCS as the datasets store it: components of the mask's pixels that would round to 0 are 1.
Image8 nnopcs_picture(const torch::Tensor& nnopcs, const torch::Tensor& mask);
// [c, h, w] in [0, 1] of an 8-bit picture; 1, 3 or 4 channels (alpha is left out).
torch::Tensor tensor_of(const Image8& image);
Image8 crop(const Image8& image, const PixelBox& box);

void write_png(const std::filesystem::path& file, const Image8& image);

}  // namespace moomill
