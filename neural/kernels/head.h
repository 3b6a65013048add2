#pragma once
// Residual perceptron of a head on raw memory: see operators.h for the equations. One call works on some rows, in tiles
// whose activations stay in the core's cache. Knows nothing of LibTorch or of threads.
#include <cstddef>
#include <cstdint>

#include "neural/kernels/layout.h"

namespace moomill {

inline constexpr int head_outputs = 16;  // columns outputs are padded to

// Widths d and h are multiples of 16. Matrices named _t are transposed, [inputs, outputs]; rows of all are
// padded_row(columns) apart, except where said; for bfloat16 all but W_out are packed, see format.h.
template <class T>
struct HeadArguments {
  int features = 0, width = 0, blocks = 0, outputs = 0;  // d, h, n, o
  // With at least one block, W_in and the first W_c act on the same y, one after the other: they are added up
  // beforehand.
  const T *in_t = nullptr, *in_bias = nullptr;            // [d, h], [h]
  const T *feature_t = nullptr, *feature_bias = nullptr;  // [n, d, h], [n, h] (the first is not used)
  const T *first_t = nullptr, *first_bias = nullptr;      // [n, h, h], [n, h]
  const T *second_t = nullptr, *second_bias = nullptr;
  const T *out_t = nullptr, *out_bias = nullptr;  // [h, 16] dense, [16]
  // Not transposed, for the backward pass.
  const T *in = nullptr, *feature = nullptr, *first = nullptr, *second = nullptr;  // [h, d], [n, h, d], [n, h, h] twice
  const T* out = nullptr;                                                          // [o, h]
};

// Where to add the gradients, dense, in the shapes of HeadWeights; all of them or (features aside) none. That of the
// first W_c and b_c are W_in's and b_in's.
template <class T>
struct HeadGradients {
  T *in = nullptr, *in_bias = nullptr, *feature = nullptr, *feature_bias = nullptr, *first = nullptr,
    *first_bias = nullptr;
  T *second = nullptr, *second_bias = nullptr, *out = nullptr, *out_bias = nullptr;
  T* features = nullptr;  // [P, d], assigned; null: not wanted
};

template <class T>
struct HeadKernels {
  // Bytes of scratch memory (64-byte aligned) a call needs.
  std::size_t (*workspace)(const HeadArguments<T>&, bool backward);
  // Rows [begin, end) of features [P, d] to out [P, o]; begin is a multiple of tile_rows. kept: kept_bytes for every
  // tile of rows below kept_rows (64-byte aligned; a multiple of tile_rows, or all rows), activations that the backward
  // pass then need not compute again.
  void (*forward)(const HeadArguments<T>&, const T* features, std::int64_t begin, std::int64_t end, T* out, void* kept,
                  std::int64_t kept_rows, void* workspace);
  void (*backward)(const HeadArguments<T>&, const T* features, std::int64_t begin, std::int64_t end,
                   const T* out_gradient, const void* kept, std::int64_t kept_rows, const HeadGradients<T>&,
                   void* workspace);
  int (*tile_rows)(const HeadArguments<T>&);
  std::size_t (*kept_bytes)(const HeadArguments<T>&);
};

// For the instruction set in use; float and double. bfloat16: float with all products but that of W_out in bfloat16,
// for processors that have it.
template <class T>
const HeadKernels<T>& head_kernels(bool bfloat16);

extern const HeadKernels<float> head_avx2, head_avx512, head_bfloat16;
extern const HeadKernels<double> head_double;

}  // namespace moomill
