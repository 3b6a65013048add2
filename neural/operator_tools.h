#pragma once
// What the fused operators share: work on all threads, sums in a fixed order, weights laid out for the kernels, checks.
#include <omp.h>
#include <torch/torch.h>

#include <algorithm>
#include <atomic>

#include "generator/core/error.h"
#include "neural/kernels/layout.h"
#include "neural/operators.h"

namespace moomill {

// Gradients of weights are summed in at most so many parts, each a fixed share of the work whatever the number of
// threads.
inline constexpr std::int64_t most_parts = 16;

// What the forward pass keeps for the backward pass beside its inputs, where computing it anew costs more than writing
// and reading it: at most so many bytes a call; the rest is computed anew. Results do not depend on it (float); tests
// set it.
inline std::atomic<std::int64_t> most_kept_bytes{std::int64_t{1} << 30};
inline constexpr std::int64_t least_kept_channels = 64;

// Calls work(index, scratch) for every index below count; scratch is the thread's own.
template <class Work>
void for_each(std::int64_t count, std::size_t scratch_bytes, Work work) {
  if (count == 0) return;
  const int threads = int(std::min<std::int64_t>(at::get_num_threads(), count));
  const std::size_t stride = (scratch_bytes + 127) / 64 * 64;  // a cache line apart
  const torch::Tensor scratch = at::empty({std::int64_t(stride) * threads + 64}, at::kByte);
  auto* start = static_cast<char*>(scratch.data_ptr());
  start += (64 - reinterpret_cast<std::uintptr_t>(start) % 64) % 64;
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
  for (std::int64_t i = 0; i < count; ++i) work(i, start + stride * omp_get_thread_num());
}

// Sum over dimension 0, in order: at::sum's order may depend on the number of threads.
inline torch::Tensor sum_in_order(const torch::Tensor& parts) {
  torch::Tensor sum = parts[0];
  for (std::int64_t i = 1; i < parts.size(0); ++i) sum = i == 1 ? sum + parts[i] : sum.add_(parts[i]);
  return sum;
}

// 64-byte aligned, as the kernels want it.
inline torch::Tensor memory_for_keeping(std::int64_t bytes) {
  return at::empty({bytes}, at::kByte);
}

// [.., rows, columns] with rows padded_row(columns) apart.
inline torch::Tensor spread_rows(const torch::Tensor& matrix) {
  auto sizes = matrix.sizes().vec();
  const std::int64_t columns = sizes.back();
  sizes.back() = padded_row(int(columns));
  torch::Tensor spread = at::empty(sizes, matrix.options());
  spread.narrow(-1, 0, columns).copy_(matrix);
  return spread;
}

// [.., k, n] in bfloat16, consecutive pairs along k side by side in the place of a float: [.., k / 2, n], rows spread.
// An odd last row is paired with zeros.
inline torch::Tensor pack_pairs(const torch::Tensor& matrix) {
  const torch::Tensor even =
      at::constant_pad_nd(matrix.detach(), {0, 0, 0, matrix.size(-2) % 2}).to(at::kBFloat16).contiguous();
  auto sizes = even.sizes().vec();
  sizes.insert(sizes.end() - 1, 2);
  sizes[sizes.size() - 3] /= 2;
  return spread_rows(even.view(sizes).transpose(-1, -2).contiguous().view(at::kFloat).squeeze(-1));
}

inline torch::Tensor pack(const torch::Tensor& matrix, bool bfloat16) {
  return bfloat16 ? pack_pairs(matrix) : spread_rows(matrix);
}

template <class T>
T* data(const torch::Tensor& tensor) {
  return tensor.defined() ? tensor.data_ptr<T>() : nullptr;
}

inline void check_tensor(const torch::Tensor& tensor, at::IntArrayRef sizes, at::ScalarType type, const char* what) {
  check(tensor.defined() && tensor.device().is_cpu() && tensor.scalar_type() == type && tensor.sizes() == sizes, what);
}

inline void check_precision(Precision precision, at::ScalarType type) {
  if (precision == Precision::float32) return;
  if (!has_bfloat16()) input_error("precision bfloat16: this processor has no AVX512-BF16; use float32.");
  check(type == at::kFloat, "bfloat16 products of float tensors only");
}

inline bool will_differentiate(const torch::autograd::variable_list& inputs) {
  if (!at::GradMode::is_enabled()) return false;
  return std::any_of(inputs.begin(), inputs.end(),
                     [](const torch::Tensor& t) { return t.defined() && t.requires_grad(); });
}

}  // namespace moomill
