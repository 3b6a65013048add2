#pragma once
// The one matrix product of the kernels, register-blocked: for every vector of sum_k a(row, k) b(k, column), calls
//   out(row, column, sum).
// b is row-major (rows ldb apart) with n a multiple of the vector's width; a(row, k) = a[row * row_stride + k *
// k_stride], so a transposed matrix needs no copy. Operands are scalars, or pairs of bfloat16 that are consecutive in k
// (then k counts pairs). What happens to the sums (bias, ReLU, accumulation) is up to out, and is inlined. Included
// only by files compiled for one instruction set; see vector.h.
#include "neural/kernels/vector.h"

namespace moomill {
namespace {

template <class S, int rows, int vectors, class Out>
MOOMILL_INLINE void product_block(int k_count, const typename S::Operand* a, std::ptrdiff_t row_stride,
                                  std::ptrdiff_t k_stride, const typename S::Operand* b, std::ptrdiff_t ldb, int row,
                                  int column, Out& out) {
  typename S::Vector sum[rows][vectors];
  MOOMILL_UNROLL for (int r = 0; r < rows; ++r) MOOMILL_UNROLL for (int v = 0; v < vectors; ++v) sum[r][v] = S::all(0);
  for (int k = 0; k < k_count; ++k, a += k_stride, b += ldb) {
    typename S::OperandVector b_row[vectors];
    MOOMILL_UNROLL for (int v = 0; v < vectors; ++v) b_row[v] = S::load_operand(b + v * S::width);
    MOOMILL_UNROLL for (int r = 0; r < rows; ++r) {
      const auto factor = S::spread_operand(a[r * row_stride]);
      MOOMILL_UNROLL for (int v = 0; v < vectors; ++v) sum[r][v] = S::multiply_add(factor, b_row[v], sum[r][v]);
    }
  }
  MOOMILL_UNROLL for (int r = 0; r < rows; ++r) MOOMILL_UNROLL for (int v = 0; v < vectors; ++v)
      out(row + r, column + v * S::width, sum[r][v]);
}

template <class S, int vectors, class Out>
MOOMILL_INLINE void product_panel(int m, int k, const typename S::Operand* a, std::ptrdiff_t row_stride,
                                  std::ptrdiff_t k_stride, const typename S::Operand* b, std::ptrdiff_t ldb, int column,
                                  Out& out) {
  int row = 0;
  for (; row + 6 <= m; row += 6)
    product_block<S, 6, vectors>(k, a + row * row_stride, row_stride, k_stride, b, ldb, row, column, out);
  if (row + 4 <= m) {
    product_block<S, 4, vectors>(k, a + row * row_stride, row_stride, k_stride, b, ldb, row, column, out);
    row += 4;
  }
  if (row + 2 <= m) {
    product_block<S, 2, vectors>(k, a + row * row_stride, row_stride, k_stride, b, ldb, row, column, out);
    row += 2;
  }
  if (row < m) product_block<S, 1, vectors>(k, a + row * row_stride, row_stride, k_stride, b, ldb, row, column, out);
}

template <class S, class Out>
__attribute__((noinline)) void product(int m, int n, int k, const typename S::Operand* a, std::ptrdiff_t row_stride,
                                       std::ptrdiff_t k_stride, const typename S::Operand* b, std::ptrdiff_t ldb,
                                       Out out) {
  int column = 0;
  constexpr int panel = S::panel_vectors * S::width;
  for (; column + panel <= n; column += panel)
    product_panel<S, S::panel_vectors>(m, k, a, row_stride, k_stride, b + column, ldb, column, out);
  if constexpr (S::panel_vectors > 2)
    if (column + 2 * S::width <= n) {
      product_panel<S, 2>(m, k, a, row_stride, k_stride, b + column, ldb, column, out);
      column += 2 * S::width;
    }
  for (; column < n; column += S::width)
    product_panel<S, 1>(m, k, a, row_stride, k_stride, b + column, ldb, column, out);
}

// c = or c += a b, c row-major.
template <class S>
struct Store {
  typename S::Scalar* c;
  std::ptrdiff_t ldc;
  MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
    S::store(c + row * ldc + column, sum);
  }
};
template <class S>
struct Add {
  typename S::Scalar* c;
  std::ptrdiff_t ldc;
  MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
    auto* place = c + row * ldc + column;
    S::store(place, S::load(place) + sum);
  }
};

}  // namespace
}  // namespace moomill
