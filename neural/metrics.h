#pragma once
// How far a prediction is from the truth: pure functions of tensors, nothing else. Images [C, h, w] or [h, w], masks
// [h, w] (above 0.5: inside), colours sRGB in [0, 1]. What cannot be measured (an empty mask) is nullopt, and Mean
// counts it.
#include <torch/torch.h>

#include <optional>

namespace moomill {

// Mean over images, each with the same weight; images without a value are counted, not averaged.
struct Mean {
  double sum = 0;
  int count = 0;    // images in the mean
  int skipped = 0;  // images without a value
  void add(std::optional<double> value);
  double value() const;  // NaN when count is 0
};

// Mean over the mask's pixels and all channels; nullopt where the mask is empty.
std::optional<double> masked_squared_error(const torch::Tensor& a, const torch::Tensor& b, const torch::Tensor& mask);
std::optional<double> masked_absolute_error(const torch::Tensor& a, const torch::Tensor& b, const torch::Tensor& mask);

// Intersection over union; nullopt when both masks are empty.
std::optional<double> mask_iou(const torch::Tensor& a, const torch::Tensor& b);

// Mean distance between keypoints [K, 3], in their unit.
double keypoint_error(const torch::Tensor& a, const torch::Tensor& b);

// Peak 1: 10 log10(1 / mse) in dB. Equal images would be infinitely good: capped.
inline constexpr double psnr_cap = 100;  // dB
double psnr(double squared_error);
std::optional<double> masked_psnr(const torch::Tensor& a, const torch::Tensor& b, const torch::Tensor& mask);

// PSNR in the mask of painting all of it in the picture's own mean colour there: what a reconstruction has to beat.
std::optional<double> mean_color_psnr(const torch::Tensor& color, const torch::Tensor& mask);

struct PixelBox {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;  // x1, y1 not in it
  bool empty() const { return x0 >= x1 || y0 >= y1; }
  int width() const { return x1 - x0; }
  int height() const { return y1 - y0; }
};
PixelBox mask_box(const torch::Tensor& mask);  // the smallest around the mask; empty for an empty mask

torch::Tensor luma(
    const torch::Tensor& color);  // [3, h, w] to [h, w], Rec. 601 weights on sRGB values, as Wang et al.'s code

// Structural similarity (Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004), [h, w] in [0, 1]: mean over all windows that
// lie in the image, 11 x 11 Gaussian of sigma 1.5, K1 = 0.01, K2 = 0.03. nullopt where a side is below 11.
std::optional<double> ssim(const torch::Tensor& a, const torch::Tensor& b);
inline constexpr int ssim_window = 11;

// SSIM of the luma over the mask's box, grown by half a window so that windows centred on every pixel of it are in, and
// to a window's size at least (cut at the image's border). a, b: [3, h, w].
std::optional<double> masked_box_ssim(const torch::Tensor& a, const torch::Tensor& b, const torch::Tensor& mask);

}  // namespace moomill
