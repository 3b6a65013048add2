#pragma once
// Vectors of one instruction set and the functions the kernels need on them. Included only by files compiled for one
// instruction set (*_avx2.cpp, *_avx512.cpp); everything is in an unnamed namespace, or the linker might keep the
// AVX-512 copy of a function for the AVX2 kernels. For the same reason the kernels use no inline functions of the
// standard library.
#include <immintrin.h>

#include <cmath>
#include <cstddef>
#include <cstdint>

#define MOOMILL_INLINE inline __attribute__((always_inline))
#define MOOMILL_UNROLL _Pragma("GCC unroll 16")

namespace moomill {
namespace {

struct FloatAvx2 {
  using Scalar = float;
  using Vector = __m256;
  using Operand = Scalar;  // of products
  using OperandVector = Vector;
  static constexpr int width = 8, panel_vectors = 2;  // registers of a product: 6 x 2 sums, 2 + 1 operands, of 16
  static Vector load(const float* p) { return _mm256_loadu_ps(p); }
  static void store(float* p, Vector v) { _mm256_storeu_ps(p, v); }
  static Vector all(float x) { return _mm256_set1_ps(x); }
  static Vector fma(Vector a, Vector b, Vector c) { return _mm256_fmadd_ps(a, b, c); }
  static Vector load_operand(const Operand* p) { return load(p); }
  static Vector spread_operand(Operand x) { return all(x); }
  static Vector multiply_add(Vector a, Vector b, Vector sum) { return fma(a, b, sum); }
  static Vector max(Vector a, Vector b) { return _mm256_max_ps(a, b); }  // b where either is NaN
  static Vector round(Vector v) { return _mm256_round_ps(v, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC); }
  // v where x is not <= 0 (so also where it is NaN), else 0.
  static Vector where_positive(Vector x, Vector v) {
    return _mm256_and_ps(_mm256_cmp_ps(x, _mm256_setzero_ps(), _CMP_NLE_UQ), v);
  }
  // Whether every |v| <= limit: false where one is NaN.
  static bool all_within(Vector v, float limit) {
    const Vector magnitude = _mm256_andnot_ps(_mm256_set1_ps(-0.0f), v);
    return _mm256_movemask_ps(_mm256_cmp_ps(magnitude, _mm256_set1_ps(limit), _CMP_LE_OQ)) == 0xff;
  }
  // What exp2_of_negative may be asked for: below, the exponent of scale leaves the range of normal numbers.
  static Vector least_exponent(Vector v) { return _mm256_max_ps(_mm256_set1_ps(-126), v); }
  // v 2^n for whole n from -126 to 0.
  static Vector scale(Vector v, Vector n) {
    const __m256i exponent = _mm256_slli_epi32(_mm256_cvtps_epi32(n), 23);
    return v * _mm256_castsi256_ps(_mm256_add_epi32(exponent, _mm256_set1_epi32(127 << 23)));
  }
  // Sine and cosine of r + quarter pi / 2 from those of r.
  static void turn(Vector quarter, Vector& sine, Vector& cosine) {
    const __m256i q = _mm256_cvtps_epi32(quarter), one = _mm256_set1_epi32(1);
    const Vector odd = _mm256_castsi256_ps(_mm256_cmpeq_epi32(_mm256_and_si256(q, one), one));
    const Vector flip_sine = _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_srli_epi32(q, 1), 31));
    const Vector flip_cosine =
        _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_srli_epi32(_mm256_add_epi32(q, one), 1), 31));
    const Vector s = _mm256_blendv_ps(sine, cosine, odd), c = _mm256_blendv_ps(cosine, sine, odd);
    sine = _mm256_xor_ps(s, flip_sine);
    cosine = _mm256_xor_ps(c, flip_cosine);
  }
};

// For gradient checks: correct, not fast.
struct DoubleAvx2 {
  using Scalar = double;
  using Vector = __m256d;
  using Operand = Scalar;  // of products
  using OperandVector = Vector;
  static constexpr int width = 4, panel_vectors = 2;
  static Vector load(const double* p) { return _mm256_loadu_pd(p); }
  static void store(double* p, Vector v) { _mm256_storeu_pd(p, v); }
  static Vector all(double x) { return _mm256_set1_pd(x); }
  static Vector fma(Vector a, Vector b, Vector c) { return _mm256_fmadd_pd(a, b, c); }
  static Vector load_operand(const Operand* p) { return load(p); }
  static Vector spread_operand(Operand x) { return all(x); }
  static Vector multiply_add(Vector a, Vector b, Vector sum) { return fma(a, b, sum); }
  static Vector max(Vector a, Vector b) { return _mm256_max_pd(a, b); }
  static Vector where_positive(Vector x, Vector v) {
    return _mm256_and_pd(_mm256_cmp_pd(x, _mm256_setzero_pd(), _CMP_NLE_UQ), v);
  }
};

#ifdef __AVX512F__
struct FloatAvx512 {
  using Scalar = float;
  using Vector = __m512;
  using Operand = Scalar;  // of products
  using OperandVector = Vector;
  static constexpr int width = 16, panel_vectors = 4;  // 6 x 4 sums, 4 + 1 operands, of 32 registers
  static Vector load(const float* p) { return _mm512_loadu_ps(p); }
  static void store(float* p, Vector v) { _mm512_storeu_ps(p, v); }
  static Vector all(float x) { return _mm512_set1_ps(x); }
  static Vector fma(Vector a, Vector b, Vector c) { return _mm512_fmadd_ps(a, b, c); }
  static Vector load_operand(const Operand* p) { return load(p); }
  static Vector spread_operand(Operand x) { return all(x); }
  static Vector multiply_add(Vector a, Vector b, Vector sum) { return fma(a, b, sum); }
  static Vector max(Vector a, Vector b) { return _mm512_max_ps(a, b); }
  static Vector round(Vector v) { return _mm512_roundscale_ps(v, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC); }
  static Vector where_positive(Vector x, Vector v) {
    return _mm512_maskz_mov_ps(_mm512_cmp_ps_mask(x, _mm512_setzero_ps(), _CMP_NLE_UQ), v);
  }
  static bool all_within(Vector v, float limit) {
    return _mm512_cmp_ps_mask(_mm512_abs_ps(v), _mm512_set1_ps(limit), _CMP_LE_OQ) == 0xffff;
  }
  static Vector least_exponent(Vector v) { return v; }
  // Any n; NaN 2^-infinity is 0, as exp2_of_negative needs it.
  static Vector scale(Vector v, Vector n) { return _mm512_scalef_ps(v, n); }
  static void turn(Vector quarter, Vector& sine, Vector& cosine) {
    const __m512i q = _mm512_cvtps_epi32(quarter), one = _mm512_set1_epi32(1);
    const __mmask16 odd = _mm512_test_epi32_mask(q, one);
    const __m512i flip_sine = _mm512_slli_epi32(_mm512_srli_epi32(q, 1), 31);
    const __m512i flip_cosine = _mm512_slli_epi32(_mm512_srli_epi32(_mm512_add_epi32(q, one), 1), 31);
    const Vector s = _mm512_mask_mov_ps(sine, odd, cosine), c = _mm512_mask_mov_ps(cosine, odd, sine);
    sine = _mm512_castsi512_ps(_mm512_xor_si512(_mm512_castps_si512(s), flip_sine));
    cosine = _mm512_castsi512_ps(_mm512_xor_si512(_mm512_castps_si512(c), flip_cosine));
  }
};

// Products of pairs of bfloat16, added up in float.
struct PairsAvx512 : FloatAvx512 {
  using Operand = std::uint32_t;  // the even k in the low half
  using OperandVector = __m512i;
  static OperandVector load_operand(const Operand* p) { return _mm512_loadu_si512(p); }
  static OperandVector spread_operand(Operand x) { return _mm512_set1_epi32(int(x)); }
  static Vector multiply_add(OperandVector a, OperandVector b, Vector sum) {
    return _mm512_dpbf16_ps(sum, __m512bh(a), __m512bh(b));
  }
};
#endif

// The next count elements of scratch memory.
template <class Element>
Element* take(char*& at, std::size_t count) {
  Element* taken = reinterpret_cast<Element*>(at);
  at += (count * sizeof(Element) + 63) / 64 * 64;
  return taken;
}

// 2^x for x <= 0, and NaN for NaN. Float: relative error 2e-7; below 2^-126 anything from 0 to that.
template <class S>
MOOMILL_INLINE typename S::Vector exp2_of_negative(typename S::Vector x) {
  if constexpr (sizeof(typename S::Scalar) == 8) {
    alignas(64) double lanes[S::width];
    S::store(lanes, x);
    for (double& lane : lanes) lane = ::exp2(lane);
    return S::load(lanes);
  } else {
    x = S::least_exponent(x);
    const auto whole = S::round(x);
    const auto rest = x - whole;
    // 1 + rest q(rest), q interpolating (2^x - 1) / x at the Chebyshev nodes of [-1/2, 1/2]: relative error 2e-7.
    auto sum = S::all(1.33813021e-3f);
    sum = S::fma(sum, rest, S::all(9.66636837e-3f));
    sum = S::fma(sum, rest, S::all(5.55038117e-2f));
    sum = S::fma(sum, rest, S::all(2.40223497e-1f));
    sum = S::fma(sum, rest, S::all(6.93147182e-1f));
    sum = S::fma(sum, rest, S::all(1.0f));
    return S::scale(sum, whole);
  }
}

}  // namespace
}  // namespace moomill
