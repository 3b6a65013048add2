#pragma once
// Coarse to fine: an implicit image (a function of the point) is evaluated on a grid, then only where the grid does not
// tell. Knows points and pixels, not networks. Pixel (x, y) of a w x h image is the point ((x + 0.5) / w, (y + 0.5) /
// h).
#include <torch/torch.h>

#include <cstdint>
#include <functional>
#include <vector>

#include "neural/metrics.h"

namespace moomill {

// Points [M, 2] in image units to [M] (silhouette logits) or [M, C] (anything else). Called with at most `chunk`
// points.
using PointFunction = std::function<torch::Tensor(const torch::Tensor& points)>;

struct RefineOptions {
  // Grid of the silhouette in pixels, a power of two; 0: a 64th of the longer side. 1: every pixel of the image.
  int mask_cell = 0;
  // A cell is refined where its corners differ, or where a logit of one is nearer to zero than this (half as near for
  // cells half as large), and so are its eight neighbours; halved down to single pixels.
  double mask_margin = 2;
  // Grid of what is interpolated inside the mask, in pixels, a power of two; 1: every pixel of the mask is evaluated.
  int surface_cell = 1;
  // Cells wholly inside the mask are interpolated where their centre is this near to the mean of their corners, per
  // channel, and the corners are within 16 times this; others are halved, down to cells of 4, and then evaluated pixel
  // by pixel.
  double surface_tolerance = 0.006;
  std::int64_t chunk = 16384;  // points evaluated at a time: what bounds the memory
};

// Cell of the silhouette's grid for an image, resolved.
int resolved_mask_cell(const RefineOptions& options, int width, int height);

// Points of pixels given as y * width + x: [M, 2].
torch::Tensor pixel_points(const std::vector<std::int64_t>& pixels, int width, int height);

// values(points) chunk by chunk.
torch::Tensor evaluate_in_chunks(const PointFunction& values, const torch::Tensor& points, std::int64_t chunk);

// Where logits are above zero: [h, w] float, 0 or 1. Starts inside `box` (grown to whole cells, and further on every
// side where the silhouette reaches its rim); cells with one of the `seeds` (pixels, y * width + x) in them or next to
// them are refined in any case: legs and tails are thinner than a cell, but keypoints lie in them. *evaluated gains the
// points evaluated.
torch::Tensor trace_mask(const PointFunction& logits, int width, int height, const PixelBox& box,
                         const std::vector<std::int64_t>& seeds, const RefineOptions& options,
                         std::int64_t* evaluated = nullptr);

// values in the mask, zero outside: [C, h, w].
torch::Tensor fill_mask(const PointFunction& values, int channels, const torch::Tensor& mask,
                        const RefineOptions& options, std::int64_t* evaluated = nullptr);

}  // namespace moomill
