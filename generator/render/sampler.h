#pragma once
// Low-discrepancy samples keyed by identity: the value of (stream, pixel, dimension pair, sample index) never depends
// on the order of evaluation. Each pair of dimensions is the first two dimensions of Sobol's sequence, shuffled and
// Owen-scrambled by hashing (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020; hash of Laine & Karras 2011
// with the constants of Vegdahl 2021), padded by decorrelated seeds.
#include <algorithm>
#include <bit>
#include <cstdint>

#include "generator/core/math.h"
#include "generator/core/random.h"

namespace moomill {

inline std::uint32_t reverse_bits(std::uint32_t x) {
  x = __builtin_bswap32(x);
  x = ((x & 0x0f0f0f0fu) << 4) | ((x >> 4) & 0x0f0f0f0fu);
  x = ((x & 0x33333333u) << 2) | ((x >> 2) & 0x33333333u);
  return ((x & 0x55555555u) << 1) | ((x >> 1) & 0x55555555u);
}

// An Owen scramble of a number whose bits are given lowest first: bit k only depends on bits below it.
inline std::uint32_t scramble_reversed(std::uint32_t x, std::uint32_t seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16) | 1u;
  x ^= x * 0x05526c56u;
  return x ^ (x * 0x53a22864u);
}

// Second Sobol dimension, bits reversed: its matrix is Pascal's triangle mod 2, so the product is a xor over supersets.
inline std::uint32_t sobol_second_reversed(std::uint32_t index) {
  std::uint32_t x = index;
  x ^= (x >> 16) & 0x0000ffffu;
  x ^= (x >> 8) & 0x00ff00ffu;
  x ^= (x >> 4) & 0x0f0f0f0fu;
  x ^= (x >> 2) & 0x33333333u;
  return x ^ ((x >> 1) & 0x55555555u);
}

inline float unit_float(std::uint32_t x) { return static_cast<float>(x >> 8) * 0x1p-24f; }  // [0, 1)

// Samples of one pixel.
class PixelSampler {
 public:
  // A pixel on its own. stream: hash of (seed, frame, camera); pixel: any number that tells pixels apart.
  PixelSampler(std::uint64_t stream, std::uint64_t pixel) : key_(mix64(stream ^ mix64(pixel + 0x9e3779b97f4a7c15ull))) {}

  // Pixel (x, y), from 0 on, of an image with `samples` a pixel. The pixels of a block take consecutive runs of one sequence
  // along a Z-order curve (Ahmed & Wonka, "Screen-space blue-noise diffusion of Monte Carlo sampling error via hierarchical
  // ordering of pixels", 2020): each has a well-spread set, and so have 2 x 2, 4 x 4, ... pixels together. So what a filter averages
  // over neighbours converges faster than with independent pixels. The errors of pixels are correlated.
  static PixelSampler in_image(std::uint64_t stream, std::uint32_t x, std::uint32_t y, int samples) {
    const int bits = std::bit_width(static_cast<std::uint32_t>(std::max(samples, 1) - 1));  // of the index within a pixel
    const int side = std::min(8, (32 - bits) / 2);                                          // bits of a coordinate within a block
    PixelSampler s(stream, (static_cast<std::uint64_t>(y >> side) << 32) | (x >> side));
    const std::uint32_t within = (1u << side) - 1;
    s.first_ = bits >= 32 ? 0 : (spread_bits(x & within) | (spread_bits(y & within) << 1)) << bits;
    return s;
  }

  // Sample `index` of the pair of dimensions `pair`, in [0, 1)^2.
  vec2 get(std::uint32_t pair, std::uint32_t index) const {
    const std::uint64_t h = mix64(key_ + pair * 0xd6e8feb86659fd93ull), h2 = mix64(h);
    return point(first_ + index, static_cast<std::uint32_t>(h), static_cast<std::uint32_t>(h2), static_cast<std::uint32_t>(h2 >> 32));
  }

  // get() of eight samples from `index` on, side by side.
  void get8(std::uint32_t pair, std::uint32_t index, vec2* out) const {
    const std::uint64_t h = mix64(key_ + pair * 0xd6e8feb86659fd93ull), h2 = mix64(h);
    const auto shuffle = static_cast<std::uint32_t>(h), sx = static_cast<std::uint32_t>(h2), sy = static_cast<std::uint32_t>(h2 >> 32);
    for (std::uint32_t i = 0; i < 8; ++i) out[i] = point(first_ + index + i, shuffle, sx, sy);
  }

 private:
  static vec2 point(std::uint32_t index, std::uint32_t shuffle, std::uint32_t scramble_x, std::uint32_t scramble_y) {
    const std::uint32_t i = reverse_bits(scramble_reversed(reverse_bits(index), shuffle));
    const std::uint32_t x = scramble_reversed(i, scramble_x);
    const std::uint32_t y = scramble_reversed(sobol_second_reversed(i), scramble_y);
    return {unit_float(reverse_bits(x)), unit_float(reverse_bits(y))};
  }
  static std::uint32_t spread_bits(std::uint32_t x) {  // a zero bit before each of the lowest 8
    x = (x | (x << 4)) & 0x0f0fu;
    x = (x | (x << 2)) & 0x3333u;
    return (x | (x << 1)) & 0x5555u;
  }

  std::uint64_t key_;
  std::uint32_t first_ = 0;
};

}  // namespace moomill
