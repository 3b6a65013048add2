#include "neural/refine.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "generator/core/error.h"

namespace moomill {

using torch::Tensor;

int resolved_mask_cell(const RefineOptions& options, int width, int height) {
  if (options.mask_cell > 0) return options.mask_cell;
  return static_cast<int>(std::bit_floor(static_cast<unsigned>(std::max(1, std::max(width, height) / 64))));
}

Tensor pixel_points(const std::vector<std::int64_t>& pixels, int width, int height) {
  Tensor points = torch::empty({static_cast<std::int64_t>(pixels.size()), 2});
  float* p = points.data_ptr<float>();
  for (const std::int64_t pixel : pixels) {
    *p++ = (static_cast<float>(pixel % width) + 0.5f) / static_cast<float>(width);
    *p++ = (static_cast<float>(pixel / width) + 0.5f) / static_cast<float>(height);
  }
  return points;
}

Tensor evaluate_in_chunks(const PointFunction& values, const Tensor& points, std::int64_t chunk) {
  check(chunk > 0, "a chunk has points");
  if (points.size(0) <= chunk) return values(points);
  std::vector<Tensor> parts;
  for (std::int64_t at = 0; at < points.size(0); at += chunk)
    parts.push_back(values(points.slice(0, at, std::min(points.size(0), at + chunk))));
  return torch::cat(parts);
}

namespace {

bool is_power_of_two(int n) {
  return n > 0 && (n & (n - 1)) == 0;
}

// Cells of `size` pixels over an image, anchored at its origin; a flag each.
struct CellGrid {
  int size, columns, rows;
  std::vector<std::uint8_t> flag;
  CellGrid(int cell, int width, int height)
      : size(cell),
        columns((width + cell - 1) / cell),
        rows((height + cell - 1) / cell),
        flag(static_cast<std::size_t>(columns) * rows, 0) {}
  std::uint8_t& at(int column, int row) { return flag[static_cast<std::size_t>(row) * columns + column]; }
};

class MaskTracer {
 public:
  MaskTracer(const PointFunction& logits, int width, int height, const RefineOptions& options)
      : logits_(logits),
        width_(width),
        height_(height),
        options_(options),
        known_(static_cast<std::size_t>(width) * height, unknown),
        filled_(known_.size(), 0),
        logit_(known_.size(), 0) {}

  Tensor run(const PixelBox& box, const std::vector<std::int64_t>& seeds) {
    int cell = first_cell_ = resolved_mask_cell(options_, width_, height_);
    CellGrid active(cell, width_, height_);
    start(active, box);
    for (;; cell /= 2) {
      for_active(active, [&](int c, int r) { want_corners(cell, c, r); });
      evaluate();
      for_active(active, [&](int c, int r) { fill(cell, c, r); });
      if (cell == 1) break;
      CellGrid finer(cell / 2, width_, height_);
      const auto refine_about = [&](int c, int r) {
        for (int row = std::max(0, 2 * (r - 1)); row < std::min(finer.rows, 2 * (r + 2)); ++row)
          for (int column = std::max(0, 2 * (c - 1)); column < std::min(finer.columns, 2 * (c + 2)); ++column)
            finer.at(column, row) = 1;
      };
      for_active(active, [&](int c, int r) {
        if (!tells(cell, c, r)) refine_about(c, r);
      });
      for (const std::int64_t seed : seeds)
        refine_about(static_cast<int>(seed % width_) / cell, static_cast<int>(seed / width_) / cell);
      active = std::move(finer);
    }
    Tensor mask = torch::empty({height_, width_});
    std::copy(filled_.begin(), filled_.end(), mask.data_ptr<float>());
    return mask;
  }

  std::int64_t evaluated = 0;

 private:
  static constexpr std::int8_t unknown = -1, wanted = -2;

  template <class Body>
  void for_active(CellGrid& grid, const Body& body) {
    for (int r = 0; r < grid.rows; ++r)
      for (int c = 0; c < grid.columns; ++c)
        if (grid.at(c, r)) body(c, r);
  }

  std::size_t pixel(int x, int y) const { return static_cast<std::size_t>(y) * width_ + x; }

  // The corner pixels of a cell; those beyond the image are drawn in to its border. A cell of one pixel is that pixel.
  std::array<std::size_t, 4> corners(int cell, int c, int r) const {
    const int step = cell == 1 ? 0 : cell;
    const int x0 = c * cell, y0 = r * cell, x1 = std::min(x0 + step, width_ - 1), y1 = std::min(y0 + step, height_ - 1);
    return {pixel(x0, y0), pixel(x1, y0), pixel(x0, y1), pixel(x1, y1)};
  }

  void want_corners(int cell, int c, int r) {
    for (const std::size_t i : corners(cell, c, r)) {
      if (known_[i] != unknown) continue;
      known_[i] = wanted;
      queue_.push_back(static_cast<std::int64_t>(i));
    }
  }

  void evaluate() {
    if (queue_.empty()) return;
    const Tensor values = evaluate_in_chunks(logits_, pixel_points(queue_, width_, height_), options_.chunk)
                              .to(torch::kFloat)
                              .contiguous();
    check(values.numel() == static_cast<std::int64_t>(queue_.size()), "one logit a point");
    const float* value = values.data_ptr<float>();
    for (const std::int64_t i : queue_) {
      known_[static_cast<std::size_t>(i)] = *value > 0;
      logit_[static_cast<std::size_t>(i)] = *value++;
    }
    evaluated += static_cast<std::int64_t>(queue_.size());
    queue_.clear();
  }

  // All cells of the box, and as many around it as it takes for its rim to be background.
  void start(CellGrid& active, const PixelBox& box) {
    if (box.empty()) return;
    const int cell = active.size;
    int c0 = std::clamp(box.x0 / cell, 0, active.columns - 1),
        c1 = std::clamp((box.x1 - 1) / cell, 0, active.columns - 1);
    int r0 = std::clamp(box.y0 / cell, 0, active.rows - 1), r1 = std::clamp((box.y1 - 1) / cell, 0, active.rows - 1);
    for (;;) {
      for (int r = r0; r <= r1; ++r)
        for (int c = c0; c <= c1; ++c) {
          if (active.at(c, r)) continue;
          active.at(c, r) = 1;
          want_corners(cell, c, r);
        }
      evaluate();
      bool left = false, right = false, top = false, bottom = false;
      for (int r = r0; r <= r1; ++r) {
        left = left || any_inside(cell, c0, r);
        right = right || any_inside(cell, c1, r);
      }
      for (int c = c0; c <= c1; ++c) {
        top = top || any_inside(cell, c, r0);
        bottom = bottom || any_inside(cell, c, r1);
      }
      const std::array<int, 4> before{c0, c1, r0, r1};
      if (left) c0 = std::max(0, c0 - 1);
      if (right) c1 = std::min(active.columns - 1, c1 + 1);
      if (top) r0 = std::max(0, r0 - 1);
      if (bottom) r1 = std::min(active.rows - 1, r1 + 1);
      if (before == std::array<int, 4>{c0, c1, r0, r1}) return;
    }
  }

  bool any_inside(int cell, int c, int r) const {
    for (const std::size_t i : corners(cell, c, r))
      if (known_[i] == 1) return true;
    return false;
  }

  bool tells(int cell, int c, int r) const {
    const std::array<std::size_t, 4> corner = corners(cell, c, r);
    const double margin = options_.mask_margin * cell / first_cell_;
    for (const std::size_t i : corner)
      if (!(std::abs(logit_[i]) >= margin) || known_[i] != known_[corner[0]]) return false;
    return true;
  }

  void fill(int cell, int c, int r) {
    const std::uint8_t value = known_[pixel(c * cell, r * cell)] == 1;
    for (int y = r * cell; y < std::min(height_, (r + 1) * cell); ++y)
      for (int x = c * cell; x < std::min(width_, (c + 1) * cell); ++x) filled_[pixel(x, y)] = value;
  }

  const PointFunction& logits_;
  int width_, height_, first_cell_ = 1;
  const RefineOptions& options_;
  std::vector<std::int8_t> known_;  // unknown, wanted, or 0 / 1 where evaluated
  std::vector<std::uint8_t> filled_;
  std::vector<float> logit_;         // where evaluated
  std::vector<std::int64_t> queue_;  // pixels to evaluate
};

}  // namespace

Tensor trace_mask(const PointFunction& logits, int width, int height, const PixelBox& box,
                  const std::vector<std::int64_t>& seeds, const RefineOptions& options, std::int64_t* evaluated) {
  check(width > 0 && height > 0, "an image has pixels");
  if (!is_power_of_two(resolved_mask_cell(options, width, height)))
    input_error("cell of the silhouette's grid: {} is not a power of two; give 1, 2, 4, 8, ... or 0",
                options.mask_cell);
  MaskTracer tracer(logits, width, height, options);
  const bool everything = options.mask_cell == 1;
  Tensor mask = tracer.run(everything ? PixelBox{0, 0, width, height} : box, seeds);
  if (evaluated) *evaluated += tracer.evaluated;
  return mask;
}

Tensor fill_mask(const PointFunction& values, int channels, const Tensor& mask, const RefineOptions& options,
                 std::int64_t* evaluated) {
  if (!is_power_of_two(options.surface_cell))
    input_error("cell of the surface's grid: {} is not a power of two; give 1 (every pixel), 4, 8, ...",
                options.surface_cell);
  const int height = static_cast<int>(mask.size(0)), width = static_cast<int>(mask.size(1));
  const Tensor inside_tensor = (mask > 0.5).to(torch::kUInt8).contiguous();
  const std::uint8_t* inside = inside_tensor.data_ptr<std::uint8_t>();
  const auto count = static_cast<std::size_t>(width) * height;
  enum : std::uint8_t { open, wanted, evaluated_here, done };
  std::vector<std::uint8_t> state(count, open);
  std::vector<float> out(count * channels, 0);
  std::vector<std::int64_t> queue;
  const auto want = [&](std::size_t i) {
    if (state[i] == wanted || state[i] == evaluated_here) return;
    state[i] = wanted;
    queue.push_back(static_cast<std::int64_t>(i));
  };
  const auto evaluate = [&] {
    if (queue.empty()) return;
    const Tensor result =
        evaluate_in_chunks(values, pixel_points(queue, width, height), options.chunk).to(torch::kFloat).contiguous();
    check(result.numel() == static_cast<std::int64_t>(queue.size()) * channels, "as many values a point as channels");
    const float* value = result.data_ptr<float>();
    for (const std::int64_t i : queue) {
      state[static_cast<std::size_t>(i)] = evaluated_here;
      std::copy_n(value, channels, out.data() + i * channels);
      value += channels;
    }
    if (evaluated) *evaluated += static_cast<std::int64_t>(queue.size());
    queue.clear();
  };

  // Cells in hand, by column and row of the level.
  struct Cell {
    int column, row;
  };
  if (options.surface_cell >= 4) {
    // Pixels of the mask above and left of a pixel, to know at once whether a cell lies inside.
    std::vector<std::int64_t> integral((static_cast<std::size_t>(width) + 1) * (height + 1), 0);
    const auto sum_at = [&](int x, int y) -> std::int64_t& {
      return integral[static_cast<std::size_t>(y) * (width + 1) + x];
    };
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x)
        sum_at(x + 1, y + 1) =
            sum_at(x, y + 1) + sum_at(x + 1, y) - sum_at(x, y) + inside[static_cast<std::size_t>(y) * width + x];
    std::vector<Cell> cells;
    for (int r = 0; r * options.surface_cell < height; ++r)
      for (int c = 0; c * options.surface_cell < width; ++c) cells.push_back({c, r});
    for (int size = options.surface_cell; size >= 4; size /= 2) {
      std::vector<Cell> whole, rest;
      for (const Cell& cell : cells) {
        const int x0 = cell.column * size, y0 = cell.row * size, x1 = x0 + size + 1,
                  y1 = y0 + size + 1;  // corners included
        const std::int64_t in = sum_at(std::min(x1, width), std::min(y1, height)) - sum_at(x0, std::min(y1, height)) -
                                sum_at(std::min(x1, width), y0) + sum_at(x0, y0);
        if (in == 0) continue;
        (in == std::int64_t{size + 1} * (size + 1) ? whole : rest).push_back(cell);
      }
      const auto corners = [&](const Cell& cell) {
        const std::size_t at =
            static_cast<std::size_t>(cell.row) * size * width + static_cast<std::size_t>(cell.column) * size;
        return std::array<std::size_t, 4>{at, at + size, at + static_cast<std::size_t>(size) * width,
                                          at + static_cast<std::size_t>(size) * width + size};
      };
      for (const Cell& cell : whole) {
        const auto corner = corners(cell);
        for (const std::size_t i : corner) want(i);
        want(corner[0] + static_cast<std::size_t>(size / 2) * width + size / 2);
      }
      evaluate();
      for (const Cell& cell : whole) {
        const auto corner = corners(cell);
        const float* centre = &out[(corner[0] + static_cast<std::size_t>(size / 2) * width + size / 2) * channels];
        std::array<const float*, 4> v;
        for (int i = 0; i < 4; ++i) v[i] = &out[corner[i] * channels];
        bool smooth = true;
        for (int c = 0; c < channels && smooth; ++c) {
          const auto [low, high] = std::minmax({v[0][c], v[1][c], v[2][c], v[3][c]});
          const float mean = (v[0][c] + v[1][c] + v[2][c] + v[3][c]) / 4;
          smooth =
              std::abs(centre[c] - mean) <= options.surface_tolerance && high - low <= 16 * options.surface_tolerance;
        }
        if (!smooth) {
          rest.push_back(cell);
          continue;
        }
        for (int y = 0; y < size; ++y)
          for (int x = 0; x < size; ++x) {
            const std::size_t i = corner[0] + static_cast<std::size_t>(y) * width + x;
            if (state[i] != open) continue;
            const float fx = static_cast<float>(x) / size, fy = static_cast<float>(y) / size;
            for (int c = 0; c < channels; ++c)
              out[i * channels + c] =
                  (1 - fy) * ((1 - fx) * v[0][c] + fx * v[1][c]) + fy * ((1 - fx) * v[2][c] + fx * v[3][c]);
            state[i] = done;
          }
      }
      cells.clear();
      for (const Cell& cell : rest)
        for (int r = 0; r < 2; ++r)
          for (int c = 0; c < 2; ++c) {
            const Cell child{2 * cell.column + c, 2 * cell.row + r};
            if (child.column * (size / 2) < width && child.row * (size / 2) < height) cells.push_back(child);
          }
    }
  }
  for (std::size_t i = 0; i < count; ++i)
    if (inside[i] && state[i] == open) want(i);
  evaluate();
  return torch::from_blob(out.data(), {height, width, channels})
      .permute({2, 0, 1})
      .clone(torch::MemoryFormat::Contiguous);
}

}  // namespace moomill
