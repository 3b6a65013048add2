#pragma once
// Fused vector attention on raw memory: see operators.h for the equations. One call works on some queries of one frame,
// in tiles that stay in the core's cache. Every matrix is row-major and dense. Knows nothing of LibTorch or of threads.
#include <cstddef>
#include <cstdint>

#include "neural/kernels/layout.h"

namespace moomill {

inline constexpr int frequencies = 5;
inline constexpr int code_rows(int components) {
  return components * (1 + 2 * frequencies);
}

template <class T>
struct AttentionArguments {
  int channels = 0;    // d, a multiple of 16
  int components = 0;  // D
  int keys = 0;        // K
  int neighbours = 0;  // keys a query attends to, without the extra one
  bool has_extra = false;
  bool shared_query = false;
  // Of all frames. Rows are padded_row(columns) apart; for bfloat16 packed, see format.h.
  const T *logit_code = nullptr, *value_code = nullptr;  // [11 D, d]
  const T *mix = nullptr, *mix_transposed = nullptr;     // [d, d]
  const T *logit_code_transposed = nullptr,
          *value_code_transposed = nullptr;  // [d, code_columns(D)], only for position gradients
  // Of this frame.
  const T* query = nullptr;  // [M, d] or [d]
  const T *key = nullptr, *value = nullptr;
  const T *query_position = nullptr, *key_position = nullptr;
  const std::int32_t* neighbour = nullptr;  // [M, n]; null: all keys
  const T *extra_key = nullptr, *extra_value = nullptr;
};

// Where to add the gradients; null where none is wanted. query and query_position are assigned unless the query is
// shared.
template <class T>
struct AttentionGradients {
  T *query = nullptr, *key = nullptr, *value = nullptr, *query_position = nullptr, *key_position = nullptr;
  T *extra_key = nullptr, *extra_value = nullptr;
  T *logit_code = nullptr, *value_code = nullptr, *mix = nullptr;  // dense
};

inline constexpr int code_columns(int components) {
  return (code_rows(components) + 15) / 16 * 16;
}

template <class T>
struct AttentionKernels {
  // Bytes of scratch memory (64-byte aligned) a call needs.
  std::size_t (*workspace)(const AttentionArguments<T>&);
  // Queries [begin, end) of the frame; out is [M, d]. kept, or null: of the frame, [M, keys of a query, d] numbers of
  // kept_size bytes (exponentials of the softmax), which spare the backward pass the product with the mix.
  void (*forward)(const AttentionArguments<T>&, std::int64_t begin, std::int64_t end, T* out, void* kept,
                  void* workspace);
  void (*backward)(const AttentionArguments<T>&, std::int64_t begin, std::int64_t end, const T* out_gradient,
                   const void* kept, const AttentionGradients<T>&, void* workspace);
  int (*tile_queries)(const AttentionArguments<T>&);  // queries a tile holds
  std::size_t kept_size;
};

// For the instruction set in use; float and double. bfloat16: float with all products in bfloat16, for processors
// that have it.
template <class T>
const AttentionKernels<T>& attention_kernels(bool bfloat16);

extern const AttentionKernels<float> attention_avx2, attention_avx512, attention_bfloat16;
extern const AttentionKernels<double> attention_double;

}  // namespace moomill
