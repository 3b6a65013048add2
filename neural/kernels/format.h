#pragma once
// In which numbers activations are kept for the large products: those of the rest of the kernel, or bfloat16. Weights
// of bfloat16 are packed in pairs along k in the place of one float, so a block of them has half as many rows; see
// pack_pairs in operators.cpp. Included only by files compiled for one instruction set; see vector.h.
#include "neural/kernels/layout.h"
#include "neural/kernels/product.h"

namespace moomill {
namespace {

template <class Vectors>
struct FullFormat {
  static constexpr bool half = false;
  using S = Vectors;
  using T = typename S::Scalar;
  using Element = T;
  // A matrix made ready to be summed over its rows in a product.
  struct Columns {
    const T* data;
    std::ptrdiff_t ld;
  };

  static MOOMILL_INLINE typename S::Vector load(const Element* p) { return S::load(p); }
  static MOOMILL_INLINE void store(Element* p, typename S::Vector v) { S::store(p, v); }
  static MOOMILL_INLINE typename S::Vector where_positive(const Element* p, typename S::Vector v) {
    return S::where_positive(S::load(p), v);
  }
  static std::ptrdiff_t weight_size(int k, std::ptrdiff_t ld) { return k * ld; }
  static std::size_t columns_bytes(int, int) { return 0; }
  static Columns columns(const Element* x, int, int, std::ptrdiff_t ld, void*) { return {x, ld}; }
  static Columns packed(const T* weights, std::ptrdiff_t ld) { return {weights, ld}; }

  // out over [m, n]: x [m, k] times weights [k, n]
  template <class Out>
  static void product_of_rows(int m, int n, int k, const Element* x, std::ptrdiff_t ldx, const T* weights,
                              std::ptrdiff_t ldw, Out out) {
    product<S>(m, n, k, x, ldx, 1, weights, ldw, out);
  }
  // out over [m, n]: the transposed a [rows, m] times b [rows, n]
  template <class Out>
  static void product_of_columns(int m, int n, int rows, Columns a, Columns b, Out out) {
    product<S>(m, n, rows, a.data, 1, a.ld, b.data, b.ld, out);
  }
  // out over [m, n]: a [m, rows] times b [rows, n]
  template <class Out>
  static void product_with_columns(int m, int n, int rows, const Element* a, std::ptrdiff_t lda, Columns b, Out out) {
    product<S>(m, n, rows, a, lda, 1, b.data, b.ld, out);
  }
};

#ifdef __AVX512BF16__
struct HalfFormat {
  static constexpr bool half = true;
  using S = FloatAvx512;
  using T = float;
  using Element = std::uint16_t;
  struct Columns {
    const std::uint32_t* data;
    std::ptrdiff_t ld;
  };

  static MOOMILL_INLINE __m256i load_bits(const Element* p) {
    return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
  }
  static MOOMILL_INLINE __m512 load(const Element* p) {
    return _mm512_castsi512_ps(_mm512_slli_epi32(_mm512_cvtepu16_epi32(load_bits(p)), 16));
  }
  static MOOMILL_INLINE void store(Element* p, __m512 v) {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), __m256i(_mm512_cvtneps_pbh(v)));
  }
  // Activations are never negative, but may be NaN of either sign, or -0.
  static MOOMILL_INLINE __m512 where_positive(const Element* p, __m512 v) {
    return _mm512_maskz_mov_ps(_mm256_test_epi16_mask(load_bits(p), _mm256_set1_epi16(0x7fff)), v);
  }
  static std::ptrdiff_t weight_size(int k, std::ptrdiff_t ld) { return k / 2 * ld; }
  static std::size_t columns_bytes(int rows, int width) {
    return std::size_t(rows + 1) / 2 * padded_row(width) * sizeof(std::uint32_t);
  }
  // Pairs of consecutive rows, interleaved; an odd last row is paired with zeros.
  static Columns columns(const Element* x, int rows, int width, std::ptrdiff_t ld, void* memory) {
    auto* const pairs = static_cast<std::uint32_t*>(memory);
    const std::ptrdiff_t pairs_ld = padded_row(width);
    for (int r = 0; r < rows; r += 2)
      for (int c = 0; c < width; c += 16) {
        __m512i pair = _mm512_cvtepu16_epi32(load_bits(x + r * ld + c));
        if (r + 1 < rows)
          pair = _mm512_or_si512(pair, _mm512_slli_epi32(_mm512_cvtepu16_epi32(load_bits(x + (r + 1) * ld + c)), 16));
        _mm512_storeu_si512(pairs + r / 2 * pairs_ld + c, pair);
      }
    return {pairs, pairs_ld};
  }
  // Weights [k, n], an odd last row paired with zeros.
  static Columns packed(const T* weights, std::ptrdiff_t ld) {
    return {reinterpret_cast<const std::uint32_t*>(weights), ld};
  }

  template <class Out>
  static void product_of_rows(int m, int n, int k, const Element* x, std::ptrdiff_t ldx, const T* weights,
                              std::ptrdiff_t ldw, Out out) {
    product<PairsAvx512>(m, n, k / 2, reinterpret_cast<const std::uint32_t*>(x), ldx / 2, 1,
                         reinterpret_cast<const std::uint32_t*>(weights), ldw, out);
  }
  template <class Out>
  static void product_of_columns(int m, int n, int rows, Columns a, Columns b, Out out) {
    product<PairsAvx512>(m, n, (rows + 1) / 2, a.data, 1, a.ld, b.data, b.ld, out);
  }
  // Where rows is odd, a has one more column, of anything finite.
  template <class Out>
  static void product_with_columns(int m, int n, int rows, const Element* a, std::ptrdiff_t lda, Columns b, Out out) {
    product<PairsAvx512>(m, n, (rows + 1) / 2, reinterpret_cast<const std::uint32_t*>(a), lda / 2, 1, b.data, b.ld,
                         out);
  }
};
#endif

}  // namespace
}  // namespace moomill
