// Fused operators against straightforward LibTorch that materialises every pair, and against finite differences.
#include "neural/operators.h"

#include <cmath>
#include <functional>

#include "generator/core/error.h"
#include "neural/kernels/cpu.h"
#include "tests/neural/doctest_torch.h"

using namespace moomill;
using torch::Tensor;

namespace {

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

AttentionTerms random_terms(const Sizes& s, at::ScalarType type, std::uint64_t seed) {
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

std::vector<Tensor> differentiable(const AttentionTerms& t) {
  std::vector<Tensor> all{t.query, t.key, t.value, t.logit_code, t.value_code, t.mix, t.query_position, t.key_position};
  if (t.extra_key.defined()) all.push_back(t.extra_key), all.push_back(t.extra_value);
  return all;
}

// rows [B, K, c] at index [B, M, n] to [B, M, n, c]
Tensor gather_rows(const Tensor& rows, const Tensor& index) {
  const auto b = index.size(0), m = index.size(1), n = index.size(2), c = rows.size(2);
  return rows.gather(1, index.view({b, m * n, 1}).expand({b, m * n, c})).view({b, m, n, c});
}

Tensor plain_attention(const AttentionTerms& t) {
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

HeadWeights random_head(int d, int h, int blocks, int outputs, at::ScalarType type, std::uint64_t seed) {
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

std::vector<Tensor> differentiable(const HeadWeights& w) {
  return {w.in_weight,  w.in_bias,       w.feature_weight, w.feature_bias, w.first_weight,
          w.first_bias, w.second_weight, w.second_bias,    w.out_weight,   w.out_bias};
}

Tensor plain_head(const Tensor& y, const HeadWeights& w) {
  Tensor net = at::linear(y, w.in_weight, w.in_bias);
  for (std::int64_t b = 0; b < w.first_weight.size(0); ++b) {
    net = net + at::linear(y, w.feature_weight[b], w.feature_bias[b]);
    const Tensor inner = at::linear(net.relu(), w.first_weight[b], w.first_bias[b]);
    net = net + at::linear(inner.relu(), w.second_weight[b], w.second_bias[b]);
  }
  return at::linear(net.relu(), w.out_weight, w.out_bias);
}

// Greatest difference, relative to the greatest magnitude of expected; infinite where one is not finite.
double worst(const Tensor& found, const Tensor& expected) {
  REQUIRE(found.sizes() == expected.sizes());
  if (expected.numel() == 0) return 0;
  const double scale = expected.abs().max().item<double>();
  const double error = (found.to(at::kDouble) - expected.to(at::kDouble)).abs().max().item<double>();
  return std::isfinite(error) ? error / std::max(scale, 1e-30) : INFINITY;
}

// Weights that make a scalar of an output, so that no gradient cancels.
Tensor loss_weights(const Tensor& out, std::uint64_t seed) {
  return at::randn(out.sizes(), at::detail::createCPUGenerator(seed), at::kDouble).to(out.scalar_type());
}

std::vector<Tensor> gradients_of(const Tensor& out, const std::vector<Tensor>& inputs, std::uint64_t seed) {
  auto gradients =
      torch::autograd::grad({(out * loss_weights(out, seed)).sum()}, inputs, {}, c10::nullopt, false, true);
  for (std::size_t i = 0; i < inputs.size(); ++i)
    if (!gradients[i].defined()) gradients[i] = at::zeros_like(inputs[i]);
  return gradients;
}

// The plain version in double of the same numbers is the truth for float.
AttentionTerms as_double(const AttentionTerms& t) {
  AttentionTerms wide = t;
  for (Tensor* tensor : {&wide.query, &wide.key, &wide.value, &wide.logit_code, &wide.value_code, &wide.mix,
                         &wide.query_position, &wide.key_position, &wide.extra_key, &wide.extra_value})
    if (tensor->defined()) *tensor = tensor->detach().to(at::kDouble).set_requires_grad(true);
  return wide;
}

void compare_attention(const Sizes& s, std::uint64_t seed, double tolerance = 1e-5, double gradient_tolerance = 1e-4) {
  CAPTURE(s.frames);
  CAPTURE(s.queries);
  CAPTURE(s.keys);
  CAPTURE(s.neighbours);
  CAPTURE(s.components);
  CAPTURE(s.channels);
  CAPTURE(s.extra);
  CAPTURE(s.shared_query);
  const AttentionTerms terms = random_terms(s, at::kFloat, seed), wide = as_double(terms);
  const Tensor out = fused_attention(terms), expected = plain_attention(wide);
  CHECK(worst(out, expected) < tolerance);
  const auto found = gradients_of(out, differentiable(terms), seed + 1);
  const auto truth = gradients_of(expected, differentiable(wide), seed + 1);
  for (std::size_t i = 0; i < truth.size(); ++i) {
    CAPTURE(i);
    CHECK(worst(found[i], truth[i]) < gradient_tolerance);
  }
}

void compare_head(int rows, int d, int h, int blocks, int outputs, std::uint64_t seed) {
  CAPTURE(rows);
  CAPTURE(d);
  CAPTURE(h);
  CAPTURE(blocks);
  CAPTURE(outputs);
  const HeadWeights weights = random_head(d, h, blocks, outputs, at::kFloat, seed);
  HeadWeights wide;
  const Tensor y = Dice(seed + 1, at::kFloat).normal({rows, d});
  auto widen = [](const Tensor& t) { return t.detach().to(at::kDouble).set_requires_grad(true); };
  wide = {widen(weights.in_weight),     widen(weights.in_bias),      widen(weights.feature_weight),
          widen(weights.feature_bias),  widen(weights.first_weight), widen(weights.first_bias),
          widen(weights.second_weight), widen(weights.second_bias),  widen(weights.out_weight),
          widen(weights.out_bias)};
  const Tensor wide_y = widen(y);
  const Tensor out = fused_head(y, weights), expected = plain_head(wide_y, wide);
  CHECK(worst(out, expected) < 1e-5);
  auto inputs = differentiable(weights), wide_inputs = differentiable(wide);
  inputs.push_back(y);
  wide_inputs.push_back(wide_y);
  const auto found = gradients_of(out, inputs, seed + 2), truth = gradients_of(expected, wide_inputs, seed + 2);
  for (std::size_t i = 0; i < truth.size(); ++i) {
    CAPTURE(i);
    CHECK(worst(found[i], truth[i]) < 1e-4);
  }
}

// Runs a test with each instruction set this processor has.
void with_each_instruction_set(const std::function<void()>& run) {
  struct Restore {
    ~Restore() { limit_instruction_set(InstructionSet::avx512); }
  } restore;
  for (const auto set : {InstructionSet::avx512, InstructionSet::avx2}) {
    if (set == InstructionSet::avx512 && best_instruction_set() != set) continue;
    limit_instruction_set(set);
    CAPTURE(int(set));
    run();
  }
}

}  // namespace

TEST_CASE("fused attention equals plain attention") {
  with_each_instruction_set([] {
    compare_attention({}, 1);
    compare_attention({.frames = 1, .queries = 1, .keys = 1, .neighbours = 0, .channels = 16, .extra = false}, 2);
    compare_attention({.frames = 1, .queries = 1, .keys = 1, .neighbours = 1, .components = 2, .channels = 16}, 3);
    compare_attention({.frames = 3, .queries = 25, .keys = 25, .neighbours = 0, .channels = 64, .extra = false}, 4);
    compare_attention({.frames = 20,
                       .queries = 61,
                       .keys = 25,
                       .neighbours = 12,
                       .components = 2,
                       .channels = 64,
                       .shared_query = true},
                      5);
    compare_attention({.frames = 2,
                       .queries = 40,
                       .keys = 25,
                       .neighbours = 20,
                       .components = 2,
                       .channels = 256,
                       .shared_query = true},
                      6);
    compare_attention(
        {.frames = 1, .queries = 300, .keys = 5, .neighbours = 1, .components = 1, .channels = 48, .extra = false}, 7);
    compare_attention({.frames = 2, .queries = 5, .keys = 150, .neighbours = 0, .channels = 80}, 8);
    compare_attention({.frames = 17, .queries = 9, .keys = 8, .neighbours = 8, .channels = 112, .extra = false}, 9);
  });
}

TEST_CASE("fused head equals plain head") {
  with_each_instruction_set([] {
    compare_head(1, 16, 16, 1, 1, 1);
    compare_head(97, 32, 48, 2, 3, 2);
    compare_head(2000, 64, 64, 5, 3, 3);
    compare_head(193, 64, 32, 5, 16, 4);
    compare_head(150, 256, 256, 5, 1, 5);
    compare_head(50, 16, 80, 0, 2, 6);
  });
}
