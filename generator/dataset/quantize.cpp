// From linear floats to the 8 bits of a file.
#include <cmath>

#include "generator/core/error.h"
#include "generator/dataset/dataset.h"

namespace moomill {
namespace {

// IEC 61966-2-1.
float srgb_of_linear(float v) {
  return v <= 0.0031308f ? 12.92f * v : 1.055f * std::pow(v, 1.0f / 2.4f) - 0.055f;
}

std::uint8_t exact_srgb8(float linear) {
  if (!(linear > 0)) return 0;  // also NaN
  if (linear >= 1) return 255;
  return static_cast<std::uint8_t>(srgb_of_linear(linear) * 255.0f + 0.5f);
}

// pow() per channel would cost more than the JPEG. The code of a value is found by its threshold: threshold[k] is the
// smallest float that rounds to k, so that the table agrees with exact_srgb8 for every float.
struct SrgbTable {
  static constexpr int cells = 4096;
  float threshold[257];
  std::uint8_t first[cells + 1];  // code at the start of a cell of linear values
  SrgbTable() {
    threshold[0] = 0;
    for (int k = 1; k < 256; ++k) {
      float low = threshold[k - 1], high = 1;
      while (std::nextafter(low, 2.0f) < high) {
        const float middle = 0.5f * (low + high);
        if (middle <= low || middle >= high) break;
        (exact_srgb8(middle) >= k ? high : low) = middle;
      }
      threshold[k] = high;
    }
    threshold[256] = 2;
    for (int c = 0; c <= cells; ++c) first[c] = exact_srgb8(static_cast<float>(c) / cells);
  }
  std::uint8_t operator()(float linear) const {
    if (!(linear > 0)) return 0;
    if (linear >= 1) return 255;
    int code = first[static_cast<int>(linear * cells)];
    while (linear >= threshold[code + 1]) ++code;
    return static_cast<std::uint8_t>(code);
  }
};

}  // namespace

Image8 to_srgb8(const ImageF& rgba, const vec3& background) {
  check(rgba.channels == 4 || rgba.channels == 3, "colour has 3 or 4 channels");
  static const SrgbTable table;
  Image8 out(rgba.width, rgba.height, 3);
  const std::size_t count = static_cast<std::size_t>(rgba.width) * rgba.height;
  const std::uint8_t blank[3] = {table(background.x), table(background.y), table(background.z)};
  for (std::size_t i = 0; i < count; ++i) {
    const float* in = rgba.data.data() + i * rgba.channels;
    std::uint8_t* to = out.data.data() + i * 3;
    const float alpha = rgba.channels == 4 ? in[3] : 1.0f;
    if (alpha == 0 && in[0] == 0 && in[1] == 0 && in[2] == 0) {
      for (int c = 0; c < 3; ++c) to[c] = blank[c];
      continue;
    }
    for (int c = 0; c < 3; ++c) to[c] = table(in[c] + (1.0f - alpha) * background[c]);
  }
  return out;
}

Image8 nnopcs_to_8bit(const ImageF& nnopcs, const ImageU32& silhouette) {
  check(nnopcs.channels == 3 && nnopcs.width == silhouette.width && nnopcs.height == silhouette.height,
        "NNOPCS and silhouette are of one size");
  Image8 out(nnopcs.width, nnopcs.height, 3);
  const std::size_t count = static_cast<std::size_t>(nnopcs.width) * nnopcs.height;
  for (std::size_t i = 0; i < count; ++i) {
    if (!silhouette.data[i]) continue;
    for (int c = 0; c < 3; ++c) {
      const float v = std::min(std::max(nnopcs.data[3 * i + c], 0.0f), 1.0f);
      // 0 would erase the colour channel in the public loader's tracking modes.
      out.data[3 * i + c] = std::max<std::uint8_t>(1, static_cast<std::uint8_t>(v * 255.0f + 0.5f));
    }
  }
  return out;
}

}  // namespace moomill
