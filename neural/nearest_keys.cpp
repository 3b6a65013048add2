#include <ATen/Parallel.h>

#include <cmath>

#include "neural/operator_tools.h"

namespace moomill {

namespace {

using torch::Tensor;

// NaN is farther than everything.
template <class T>
bool nearer(T a, T b) {
  return a < b || (std::isnan(b) && !std::isnan(a));
}

template <class T>
void nearest_of_frame(const T* query, const T* key, std::int64_t keys, int components, int n, std::int32_t* out,
                      std::vector<T>& distance) {
  distance.resize(n);
  int found = 0;
  for (std::int64_t k = 0; k < keys; ++k) {
    T square = 0;
    for (int c = 0; c < components; ++c)
      square += (query[c] - key[k * components + c]) * (query[c] - key[k * components + c]);
    if (found == n && !nearer(square, distance[n - 1])) continue;
    int at = found < n ? found++ : n - 1;
    for (; at > 0 && nearer(square, distance[at - 1]); --at) distance[at] = distance[at - 1], out[at] = out[at - 1];
    distance[at] = square;
    out[at] = std::int32_t(k);
  }
}

template <class T>
void find_nearest(const Tensor& queries, const Tensor& keys, int n, Tensor& out) {
  const std::int64_t per_frame = queries.size(1), key_count = keys.size(1);
  const int components = int(queries.size(2));
  at::parallel_for(0, queries.size(0) * per_frame, 1024, [&](std::int64_t begin, std::int64_t end) {
    std::vector<T> distance;
    for (std::int64_t q = begin; q < end; ++q)
      nearest_of_frame(data<T>(queries) + q * components, data<T>(keys) + q / per_frame * key_count * components,
                       key_count, components, n, out.data_ptr<std::int32_t>() + q * n, distance);
  });
}

}  // namespace

Tensor nearest_keys(const Tensor& query_position, const Tensor& key_position, int n) {
  check(query_position.defined() && key_position.defined() && query_position.dim() == 3 && key_position.dim() == 3 &&
            query_position.size(0) == key_position.size(0) && query_position.size(2) == key_position.size(2),
        "nearest_keys: queries and keys of the same frames and components");
  check(query_position.scalar_type() == key_position.scalar_type() && query_position.device().is_cpu() &&
            key_position.device().is_cpu(),
        "nearest_keys: positions of one type, on the CPU");
  check(n >= 1 && n <= key_position.size(1), "nearest_keys: n from 1 to the number of keys");
  const Tensor queries = query_position.detach().contiguous(), keys = key_position.detach().contiguous();
  Tensor out = at::empty({queries.size(0), queries.size(1), n}, queries.options().dtype(at::kInt).requires_grad(false));
  if (queries.scalar_type() == at::kFloat)
    find_nearest<float>(queries, keys, n, out);
  else {
    check(queries.scalar_type() == at::kDouble, "nearest_keys: float or double");
    find_nearest<double>(queries, keys, n, out);
  }
  return out;
}

}  // namespace moomill
