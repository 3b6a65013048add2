#pragma once
// The fused operators written in straightforward LibTorch that materialises every pair, with random inputs: what tests
// hold them against, and what benchmarks compare them with.
#include <torch/torch.h>

#include <cmath>
#include <vector>

#include "neural/operators.h"

namespace moomill::plain {

using torch::Tensor;

struct Sizes {
  int frames = 2, queries = 7, keys = 9, neighbours = 4, components = 3, channels = 32;  // neighbours 0: all keys
  bool extra = true, shared_query = false;
};

// Numbers that depend on nothing but the seed: the tests run in any order, on any number of threads.
struct Dice {
  torch::Generator generator;
  torch::TensorOptions options;
  Dice(std::uint64_t seed, at::ScalarType type) : generator(at::detail::createCPUGenerator(seed)), options(type) {}
  Tensor normal(std::vector<std::int64_t> sizes, double scale = 1) {
    return (at::randn(sizes, generator, at::kDouble) * scale).to(options.dtype()).set_requires_grad(true);
  }
};

inline AttentionTerms random_terms(const Sizes& s, at::ScalarType type, std::uint64_t seed) {
  Dice dice(seed, type);
  const int d = s.channels, rows = 11 * s.components;
  AttentionTerms t;
  t.query = dice.normal({s.frames, s.shared_query ? 1 : s.queries, d});
  t.key = dice.normal({s.frames, s.keys, d});
  t.value = dice.normal({s.frames, s.keys, d});
  t.logit_code = dice.normal({rows, d}, 0.3);
  t.value_code = dice.normal({rows, d}, 0.3);
  t.mix = dice.normal({d, d}, 1.5 / std::sqrt(d));
  t.query_position = dice.normal({s.frames, s.queries, s.components}, 0.4);
  t.key_position = dice.normal({s.frames, s.keys, s.components}, 0.4);
  if (s.neighbours > 0)
    t.neighbours = at::rand({s.frames, s.queries, s.keys}, dice.generator, at::kFloat)
                       .argsort(std::int64_t{2})
                       .narrow(2, 0, s.neighbours)
                       .to(at::kInt)
                       .contiguous();
  if (s.extra) t.extra_key = dice.normal({s.frames, d}), t.extra_value = dice.normal({s.frames, d});
  return t;
}

inline std::vector<Tensor> differentiable(const AttentionTerms& t) {
  std::vector<Tensor> all{t.query, t.key, t.value, t.logit_code, t.value_code, t.mix, t.query_position, t.key_position};
  if (t.extra_key.defined()) all.push_back(t.extra_key), all.push_back(t.extra_value);
  return all;
}

// rows [B, K, c] at index [B, M, n] to [B, M, n, c]
inline Tensor gather_rows(const Tensor& rows, const Tensor& index) {
  const auto b = index.size(0), m = index.size(1), n = index.size(2), c = rows.size(2);
  return rows.gather(1, index.view({b, m * n, 1}).expand({b, m * n, c})).view({b, m, n, c});
}

inline Tensor attention(const AttentionTerms& t) {
  const auto frames = t.key.size(0), queries = t.query_position.size(1), keys = t.key.size(1);
  const Tensor index =
      t.neighbours.defined()
          ? t.neighbours.to(at::kLong)
          : at::arange(keys, at::kLong).view({1, 1, keys}).expand({frames, queries, keys}).contiguous();
  const Tensor difference = t.query_position.unsqueeze(2) - gather_rows(t.key_position, index);
  std::vector<Tensor> code{difference};
  for (int k = 0; k < 5; ++k) {
    const Tensor angle = difference * (1 + 7.75 * k);
    code.push_back(angle.sin());
    code.push_back(angle.cos());
  }
  const Tensor g = torch::cat(code, 3);
  Tensor hidden = t.query.unsqueeze(2) - gather_rows(t.key, index) + g.matmul(t.logit_code);
  Tensor value = gather_rows(t.value, index) + g.matmul(t.value_code);
  if (t.extra_key.defined()) {
    const Tensor extra = (t.query - t.extra_key.unsqueeze(1)).unsqueeze(2);
    hidden = torch::cat({hidden, extra.expand({frames, queries, 1, extra.size(3)})}, 2);
    value = torch::cat({value, t.extra_value.view({frames, 1, 1, -1}).expand({frames, queries, 1, value.size(3)})}, 2);
  }
  const Tensor logit = hidden.relu().matmul(t.mix.t());
  return (logit.softmax(2) * value).sum(2);
}

inline HeadWeights random_head(int d, int h, int blocks, int outputs, at::ScalarType type, std::uint64_t seed) {
  Dice dice(seed, type);
  HeadWeights w;
  w.in_weight = dice.normal({h, d}, 1 / std::sqrt(d));
  w.in_bias = dice.normal({h}, 0.3);
  w.feature_weight = dice.normal({blocks, h, d}, 1 / std::sqrt(d));
  w.feature_bias = dice.normal({blocks, h}, 0.3);
  w.first_weight = dice.normal({blocks, h, h}, 1 / std::sqrt(h));
  w.first_bias = dice.normal({blocks, h}, 0.3);
  w.second_weight = dice.normal({blocks, h, h}, 1 / std::sqrt(h));
  w.second_bias = dice.normal({blocks, h}, 0.3);
  w.out_weight = dice.normal({outputs, h}, 1 / std::sqrt(h));
  w.out_bias = dice.normal({outputs}, 0.3);
  return w;
}

inline std::vector<Tensor> differentiable(const HeadWeights& w) {
  return {w.in_weight,  w.in_bias,       w.feature_weight, w.feature_bias, w.first_weight,
          w.first_bias, w.second_weight, w.second_bias,    w.out_weight,   w.out_bias};
}

inline Tensor head(const Tensor& y, const HeadWeights& w) {
  Tensor net = at::linear(y, w.in_weight, w.in_bias);
  for (std::int64_t b = 0; b < w.first_weight.size(0); ++b) {
    net = net + at::linear(y, w.feature_weight[b], w.feature_bias[b]);
    const Tensor inner = at::linear(net.relu(), w.first_weight[b], w.first_bias[b]);
    net = net + at::linear(inner.relu(), w.second_weight[b], w.second_bias[b]);
  }
  return at::linear(net.relu(), w.out_weight, w.out_bias);
}

}  // namespace moomill::plain
