#pragma once
// Images as plain values: row-major, interleaved channels, top row first.
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace moomill {

template <class T>
struct Image {
  int width = 0, height = 0, channels = 0;
  std::vector<T> data;

  Image() = default;
  Image(int w, int h, int c, T value = T{})
      : width(w), height(h), channels(c), data(static_cast<std::size_t>(w) * h * c, value) {}

  bool empty() const { return data.empty(); }
  std::size_t index(int x, int y, int c = 0) const {
    return (static_cast<std::size_t>(y) * width + x) * channels + c;
  }
  T& at(int x, int y, int c = 0) { return data[index(x, y, c)]; }
  const T& at(int x, int y, int c = 0) const { return data[index(x, y, c)]; }
};

using ImageF = Image<float>;
using Image8 = Image<std::uint8_t>;
using ImageU32 = Image<std::uint32_t>;

// How a texture goes on beyond its border.
enum class Wrap : std::uint8_t { repeat, mirror, clamp };

// An image as it came in a file, not decoded; decoded only when something needs its pixels.
struct EncodedImage {
  std::string name;                 // for messages
  std::vector<std::uint8_t> bytes;  // the whole file (PNG, JPEG, ...)
};

}  // namespace moomill
