#pragma once
// Pictures made smaller (or larger): a pixel becomes the mean of the area it covers.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace moomill {

// A stretch of an axis, in source cells; may reach beyond them.
struct Stretch {
  double low = 0, high = 0;
  double length() const { return high - low; }
};

// How much of each source cell falls into which destination cells along one axis, where the destination covers `window`
// of the source. The shares of a destination cell inside the source add up to 1.
struct AxisShares {
  struct Share {
    int to;
    float weight;
  };
  std::vector<int> begin;  // per source cell, and the end
  std::vector<Share> shares;
  AxisShares(int from, int to, Stretch window) {
    const double scale = to / window.length();
    for (int i = 0; i < from; ++i) {
      begin.push_back(static_cast<int>(shares.size()));
      const double low = (i - window.low) * scale, high = (i + 1 - window.low) * scale;
      for (int j = static_cast<int>(std::clamp(std::floor(low), 0.0, static_cast<double>(to))); j < to && j < high; ++j) {
        const double overlap = std::min(high, j + 1.0) - std::max(low, static_cast<double>(j));
        if (overlap > 1e-9) shares.push_back({j, static_cast<float>(overlap)});
      }
    }
    begin.push_back(static_cast<int>(shares.size()));
  }
};

// What part of a picture the texture encoder is shown.
struct Window {
  Stretch x, y;
};

inline Window whole_picture(int width, int height) {
  return {{0, static_cast<double>(width)}, {0, static_cast<double>(height)}};
}

// The animal's window: where the middle 99 % of the mask's mass lie along each axis, so that a stray pixel does not widen it,
// a twelfth wider on every side, then grown to the proportions of to_width x to_height; at least 8 pixels each way.
// columns, rows: the mask's sums. The whole picture where the mask is empty.
inline Window mask_window(const std::vector<double>& columns, const std::vector<double>& rows, int to_width,
                          int to_height) {
  constexpr double tail = 0.005, margin = 1.0 / 12, least = 8;
  const auto middle = [](const std::vector<double>& mass) {
    double all = 0;
    for (const double m : mass) all += m;
    Stretch s{0, static_cast<double>(mass.size())};
    if (!(all > 0)) return s;
    double sum = 0;
    for (std::size_t i = 0; i < mass.size(); ++i) {
      const double before = sum, after = sum + mass[i];
      if (before <= tail * all && after > tail * all) s.low = i + (tail * all - before) / mass[i];
      if (before < (1 - tail) * all && after >= (1 - tail) * all) s.high = i + ((1 - tail) * all - before) / mass[i];
      sum = after;
    }
    return s;
  };
  const auto grown = [](Stretch s, double length) {
    const double centre = (s.low + s.high) / 2;
    return Stretch{centre - length / 2, centre + length / 2};
  };
  double any = 0;
  for (const double m : columns) any += m;
  if (!(any > 0)) return whole_picture(static_cast<int>(columns.size()), static_cast<int>(rows.size()));
  const Stretch x = middle(columns), y = middle(rows);
  // Square source pixels stay square: one scale, the larger of the two.
  const double across = std::max(x.length() * (1 + 2 * margin), least) / to_width;
  const double down = std::max(y.length() * (1 + 2 * margin), least) / to_height;
  const double scale = std::max(across, down);
  return {grown(x, scale * to_width), grown(y, scale * to_height)};
}

struct AreaAverage {
  int width, height;  // of the source
  int to_width, to_height;
  AxisShares x, y;
  AreaAverage(int w, int h, int tw, int th) : AreaAverage(w, h, tw, th, whole_picture(w, h)) {}
  AreaAverage(int w, int h, int tw, int th, const Window& window)
      : width(w), height(h), to_width(tw), to_height(th), x(w, tw, window.x), y(h, th, window.y) {}
  // Adds pixel (px, py) of `channels` values to planes [channels, to_height, to_width].
  template <class Values>
  void add(int px, int py, int channels, const Values& values, float* planes) const {
    const std::size_t plane = static_cast<std::size_t>(to_width) * to_height;
    for (int j = y.begin[py]; j < y.begin[py + 1]; ++j)
      for (int i = x.begin[px]; i < x.begin[px + 1]; ++i) {
        const float weight = x.shares[i].weight * y.shares[j].weight;
        float* to = planes + static_cast<std::size_t>(y.shares[j].to) * to_width + x.shares[i].to;
        for (int c = 0; c < channels; ++c) to[c * plane] += weight * values[c];
      }
  }
};

}  // namespace moomill
