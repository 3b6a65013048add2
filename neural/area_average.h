#pragma once
// Pictures made smaller (or larger): a pixel becomes the mean of the area it covers.
#include <algorithm>
#include <cstddef>
#include <vector>

namespace moomill {

// How much of each source cell falls into which destination cells along one axis; a destination cell's shares add up
// to 1.
struct AxisShares {
  struct Share {
    int to;
    float weight;
  };
  std::vector<int> begin;  // per source cell, and the end
  std::vector<Share> shares;
  AxisShares(int from, int to) {
    const double scale = static_cast<double>(to) / from;
    for (int i = 0; i < from; ++i) {
      begin.push_back(static_cast<int>(shares.size()));
      const double low = i * scale, high = (i + 1) * scale;
      for (int j = static_cast<int>(low); j < to && j < high; ++j) {
        const double overlap = std::min(high, j + 1.0) - std::max(low, static_cast<double>(j));
        if (overlap > 1e-9) shares.push_back({j, static_cast<float>(overlap)});
      }
    }
    begin.push_back(static_cast<int>(shares.size()));
  }
};

struct AreaAverage {
  int width, height;  // of the source
  int to_width, to_height;
  AxisShares x, y;
  AreaAverage(int w, int h, int tw, int th) : width(w), height(h), to_width(tw), to_height(th), x(w, tw), y(h, th) {}
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
