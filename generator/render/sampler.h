#pragma once
// Low-discrepancy samples keyed by identity: the value of (stream, pixel, dimension pair, sample index) never depends
// on the order of evaluation. Each pair of dimensions is the first two dimensions of Sobol's sequence, shuffled and
// Owen-scrambled by hashing (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020; hash of Laine & Karras 2011
// with the constants of Vegdahl 2021), padded by decorrelated seeds.
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
  // stream: hash of (seed, frame, camera); pixel: index in the image.
  PixelSampler(std::uint64_t stream, std::uint64_t pixel) : key_(mix64(stream ^ mix64(pixel + 0x9e3779b97f4a7c15ull))) {}

  // Sample `index` of the pair of dimensions `pair`, in [0, 1)^2.
  vec2 get(std::uint32_t pair, std::uint32_t index) const {
    const std::uint64_t h = mix64(key_ + pair * 0xd6e8feb86659fd93ull);
    const auto shuffle = static_cast<std::uint32_t>(h);
    const std::uint64_t h2 = mix64(h);
    const std::uint32_t i = reverse_bits(scramble_reversed(reverse_bits(index), shuffle));
    const std::uint32_t x = scramble_reversed(i, static_cast<std::uint32_t>(h2));
    const std::uint32_t y = scramble_reversed(sobol_second_reversed(i), static_cast<std::uint32_t>(h2 >> 32));
    return {unit_float(reverse_bits(x)), unit_float(reverse_bits(y))};
  }

 private:
  std::uint64_t key_;
};

}  // namespace moomill
