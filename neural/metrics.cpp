#include "neural/metrics.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "generator/core/error.h"

namespace moomill {

using torch::Tensor;

void Mean::add(std::optional<double> value) {
  if (!value) {
    ++skipped;
    return;
  }
  sum += *value;
  ++count;
}

double Mean::value() const {
  return count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
}

namespace {

// The mask's pixels as [P, C] in double.
Tensor masked_values(const Tensor& image, const Tensor& mask) {
  const Tensor flat = image.dim() == 3 ? image.flatten(1) : image.flatten().unsqueeze(0);
  const Tensor inside = (mask > 0.5).flatten();
  check(flat.size(1) == inside.size(0), "image and mask differ in size");
  return flat.index({torch::indexing::Slice(), inside}).to(torch::kDouble).t();
}

}  // namespace

std::optional<double> masked_squared_error(const Tensor& a, const Tensor& b, const Tensor& mask) {
  const Tensor difference = masked_values(a, mask) - masked_values(b, mask);
  if (difference.numel() == 0) return std::nullopt;
  return difference.square().mean().item<double>();
}

std::optional<double> masked_absolute_error(const Tensor& a, const Tensor& b, const Tensor& mask) {
  const Tensor difference = masked_values(a, mask) - masked_values(b, mask);
  if (difference.numel() == 0) return std::nullopt;
  return difference.abs().mean().item<double>();
}

std::optional<double> mask_iou(const Tensor& a, const Tensor& b) {
  const Tensor in_a = a > 0.5, in_b = b > 0.5;
  const auto all = (in_a | in_b).sum().item<std::int64_t>();
  if (all == 0) return std::nullopt;
  return static_cast<double>((in_a & in_b).sum().item<std::int64_t>()) / static_cast<double>(all);
}

double keypoint_error(const Tensor& a, const Tensor& b) {
  return (a.to(torch::kDouble) - b.to(torch::kDouble)).square().sum(-1).sqrt().mean().item<double>();
}

double psnr(double squared_error) {
  if (squared_error <= 0) return psnr_cap;
  return std::min(psnr_cap, -10 * std::log10(squared_error));
}

std::optional<double> masked_psnr(const Tensor& a, const Tensor& b, const Tensor& mask) {
  const std::optional<double> error = masked_squared_error(a, b, mask);
  return error ? std::optional(psnr(*error)) : std::nullopt;
}

std::optional<double> mean_color_psnr(const Tensor& color, const Tensor& mask) {
  const Tensor values = masked_values(color, mask);
  if (values.numel() == 0) return std::nullopt;
  return psnr((values - values.mean(0, true)).square().mean().item<double>());
}

PixelBox mask_box(const Tensor& mask) {
  const Tensor inside = mask > 0.5;
  const Tensor columns = inside.any(0).nonzero().flatten(), rows = inside.any(1).nonzero().flatten();
  if (rows.size(0) == 0) return {};
  return {static_cast<int>(columns[0].item<std::int64_t>()), static_cast<int>(rows[0].item<std::int64_t>()),
          static_cast<int>(columns[-1].item<std::int64_t>()) + 1, static_cast<int>(rows[-1].item<std::int64_t>()) + 1};
}

Tensor luma(const Tensor& color) {
  return 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2];
}

std::optional<double> ssim(const Tensor& a, const Tensor& b) {
  check(a.sizes() == b.sizes() && a.dim() == 2, "SSIM compares two [h, w] images of one size");
  if (a.size(0) < ssim_window || a.size(1) < ssim_window) return std::nullopt;
  const Tensor offset = torch::arange(ssim_window, torch::kDouble) - ssim_window / 2;
  Tensor window = torch::exp(-offset.square() / (2 * 1.5 * 1.5));
  window = window / window.sum();
  // Separable: columns, then rows, of the five moments at once.
  const auto blur = [&](const Tensor& images) {
    const Tensor down = torch::conv2d(images.unsqueeze(1), window.view({1, 1, -1, 1}));
    return torch::conv2d(down, window.view({1, 1, 1, -1})).squeeze(1);
  };
  const Tensor x = a.to(torch::kDouble), y = b.to(torch::kDouble);
  const Tensor m = blur(torch::stack({x, y, x * x, y * y, x * y}));
  const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
  const Tensor variance_x = m[2] - m[0] * m[0], variance_y = m[3] - m[1] * m[1], covariance = m[4] - m[0] * m[1];
  const Tensor map = ((2 * m[0] * m[1] + c1) * (2 * covariance + c2)) /
                     ((m[0] * m[0] + m[1] * m[1] + c1) * (variance_x + variance_y + c2));
  return map.mean().item<double>();
}

std::optional<double> masked_box_ssim(const Tensor& a, const Tensor& b, const Tensor& mask) {
  PixelBox box = mask_box(mask);
  if (box.empty()) return std::nullopt;
  const auto grow = [](int& low, int& high, int size) {
    low -= ssim_window / 2;
    high += ssim_window / 2;
    if (low < 0) high = std::max(high, ssim_window);
    if (high > size) low = std::min(low, size - ssim_window);
    low = std::max(low, 0);
    high = std::min(high, size);
  };
  grow(box.x0, box.x1, static_cast<int>(mask.size(1)));
  grow(box.y0, box.y1, static_cast<int>(mask.size(0)));
  const auto cut = [&](const Tensor& color) {
    using torch::indexing::Slice;
    return luma(color.index({Slice(), Slice(box.y0, box.y1), Slice(box.x0, box.x1)}));
  };
  return ssim(cut(a), cut(b));
}

}  // namespace moomill
