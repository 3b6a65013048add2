#pragma once
// The positional code g(d) of many pairs at once. Included only by files compiled for one instruction set; see
// vector.h.
#include "neural/kernels/attention.h"
#include "neural/kernels/vector.h"

namespace moomill {
namespace {

inline constexpr double frequency_step = 7.75;  // f_k = 1 + 7.75 k: 1 to 32
inline constexpr float fast_angle = 1000;  // up to here float reduction is accurate; above, double precision, slowly

// Sine and cosine of x + rest for |x| < 10^4, |rest| tiny; absolute error about 1e-7.
template <class S>
MOOMILL_INLINE void sine_cosine(typename S::Vector x, typename S::Vector rest, typename S::Vector& sine,
                                typename S::Vector& cosine) {
  const auto quarter = S::round(x * S::all(0.636619772f));
  // pi / 2 in two parts of a float each; the products are exact inside the fused operation.
  auto r = S::fma(quarter, S::all(-1.57079637f), x);
  r = S::fma(quarter, S::all(4.37113883e-8f), r) + rest;
  const auto square = r * r;
  auto s = S::all(1.0f / 362880);
  s = S::fma(s, square, S::all(-1.0f / 5040));
  s = S::fma(s, square, S::all(1.0f / 120));
  s = S::fma(s, square, S::all(-1.0f / 6));
  sine = S::fma(s * square, r, r);
  auto c = S::all(1.0f / 40320);
  c = S::fma(c, square, S::all(-1.0f / 720));
  c = S::fma(c, square, S::all(1.0f / 24));
  c = S::fma(c, square, S::all(-0.5f));
  cosine = S::fma(c, square, S::all(1));
  S::turn(quarter, sine, cosine);
}

// code[row * stride + pair], rows in the order of operators.h: row 0 to components - 1 hold the differences on entry,
// for pairs [0, count), and are kept; the rest is filled in. count is a multiple of the vector's width.
template <class S>
void position_code(int components, int count, typename S::Scalar* code, std::ptrdiff_t stride) {
  using T = typename S::Scalar;
  for (int component = 0; component < components; ++component)
    for (int pair = 0; pair < count; pair += S::width) {
      T* place = code + component * stride + pair;
      auto row = [&](int k) { return place + k * components * stride; };
      if constexpr (sizeof(T) == 4) {
        const auto d = S::load(place);
        if (S::all_within(d, fast_angle)) {
          typename S::Vector sine, cosine, step_sine, step_cosine;
          sine_cosine<S>(d, S::all(0), sine, cosine);
          const auto stepped = d * S::all(float(frequency_step));
          sine_cosine<S>(stepped, S::fma(d, S::all(float(frequency_step)), S::all(0) - stepped), step_sine,
                         step_cosine);
          for (int k = 0; k < frequencies; ++k) {
            S::store(row(1 + 2 * k), sine);
            S::store(row(2 + 2 * k), cosine);
            const auto next = S::fma(sine, step_cosine, cosine * step_sine);
            cosine = S::fma(cosine, step_cosine, S::all(0) - sine * step_sine);
            sine = next;
          }
          continue;
        }
      }
      for (int lane = 0; lane < S::width; ++lane)
        for (int k = 0; k < frequencies; ++k) {
          const double angle = (1 + frequency_step * k) * double(place[lane]);
          row(1 + 2 * k)[lane] = T(::sin(angle));
          row(2 + 2 * k)[lane] = T(::cos(angle));
        }
    }
}

// Adds to no one: gradient[pair * components + c] = d(loss)/d(difference) from d(loss)/d(code) (code_gradient,
// pair-major, rows ld apart) and the code itself. Cosines are derivatives of sines and the other way round, so nothing
// is computed anew.
template <class S>
void position_code_backward(int components, int count, const typename S::Scalar* code, std::ptrdiff_t stride,
                            const typename S::Scalar* code_gradient, std::ptrdiff_t ld, typename S::Scalar* gradient) {
  using T = typename S::Scalar;
  for (int pair = 0; pair < count; ++pair)
    for (int component = 0; component < components; ++component) {
      const T* g = code_gradient + pair * ld + component;
      const T* value = code + component * stride + pair;
      T sum = g[0];
      for (int k = 0; k < frequencies; ++k) {
        const int s = (1 + 2 * k) * components, c = (2 + 2 * k) * components;
        sum += T(1 + frequency_step * k) * (g[s] * value[c * stride] - g[c] * value[s * stride]);
      }
      gradient[pair * components + component] = sum;
    }
}

}  // namespace
}  // namespace moomill
