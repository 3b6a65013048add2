// Fused attention and heads, forward and backward, beside plain LibTorch, in GFlop/s of their matrix products: those of
// the equations in operators.h, without recomputation.
#include <benchmark/benchmark.h>
#include <torch/torch.h>

#include "generator/core/parallel.h"
#include "neural/operators.h"
#include "tests/neural/plain_operators.h"

using namespace moomill;

namespace {

constexpr double giga = 1e9;

struct Case {
  plain::Sizes attention;
  int head_width, head_blocks;
};

Case compact(int frames) {
  return {{.frames = frames,
           .queries = 768,
           .keys = 25,
           .neighbours = 12,
           .components = 2,
           .channels = 64,
           .shared_query = true},
          64,
          5};
}
Case paper(int frames) {
  return {{.frames = frames,
           .queries = 2000,
           .keys = 25,
           .neighbours = 20,
           .components = 2,
           .channels = 256,
           .shared_query = true},
          256,
          5};
}

void set_threads(benchmark::State& state) {
  at::set_num_threads(int(state.range(0)));
}

void report(benchmark::State& state, double flops) {
  state.counters["GFlop/s"] = benchmark::Counter(flops / giga, benchmark::Counter::kIsIterationInvariantRate);
}

// What a training step asks of the cross-attention of query pixels: gradients of all but positions.
void attention(benchmark::State& state, Case c, bool fused, Precision precision) {
  set_threads(state);
  if (precision == Precision::bfloat16 && !has_bfloat16()) return state.SkipWithError("no AVX512-BF16");
  AttentionTerms terms = plain::random_terms(c.attention, at::kFloat, 1);
  terms.query_position = terms.query_position.detach();
  terms.key_position = terms.key_position.detach();
  std::vector<torch::Tensor> inputs;
  for (const auto& tensor : plain::differentiable(terms))
    if (tensor.requires_grad()) inputs.push_back(tensor);
  const torch::Tensor gradient = at::ones({c.attention.frames, c.attention.queries, c.attention.channels});
  for (auto _ : state) {
    const torch::Tensor out = fused ? fused_attention(terms, precision) : plain::attention(terms);
    benchmark::DoNotOptimize(torch::autograd::grad({out}, inputs, {gradient}));
  }
  const double d = c.attention.channels, n = c.attention.neighbours, rows = 11 * c.attention.components;
  report(state, 3.0 * c.attention.frames * c.attention.queries * (2 * d * d * (n + 1) + 4 * rows * d * n));
}

void head(benchmark::State& state, Case c, bool fused, Precision precision) {
  set_threads(state);
  if (precision == Precision::bfloat16 && !has_bfloat16()) return state.SkipWithError("no AVX512-BF16");
  const int d = c.attention.channels, h = c.head_width, rows = c.attention.frames * c.attention.queries;
  const HeadWeights weights = plain::random_head(d, h, c.head_blocks, 3, at::kFloat, 1);
  const torch::Tensor features = plain::Dice(2, at::kFloat).normal({rows, d});
  auto inputs = plain::differentiable(weights);
  inputs.push_back(features);
  const torch::Tensor gradient = at::ones({rows, 3});
  for (auto _ : state) {
    const torch::Tensor out = fused ? fused_head(features, weights, precision) : plain::head(features, weights);
    benchmark::DoNotOptimize(torch::autograd::grad({out}, inputs, {gradient}));
  }
  report(state, 3.0 * rows * 2 * (double(d) * h + c.head_blocks * (double(d) * h + 2.0 * h * h) + 3.0 * h));
}

void nearest(benchmark::State& state, Case c) {
  set_threads(state);
  const AttentionTerms terms = plain::random_terms(c.attention, at::kFloat, 1);
  for (auto _ : state)
    benchmark::DoNotOptimize(nearest_keys(terms.query_position, terms.key_position, c.attention.neighbours));
}

}  // namespace

// Plain and fused at sizes the plain version can hold, then fused at the sizes of training. The argument is the number
// of threads.
#define MOOMILL_BENCH(name, ...)       \
  BENCHMARK_CAPTURE(name, __VA_ARGS__) \
      ->Arg(1)                         \
      ->Arg(2)                         \
      ->Unit(benchmark::kMillisecond)  \
      ->UseRealTime()                  \
      ->MeasureProcessCPUTime()
MOOMILL_BENCH(attention, compact_plain_8, compact(8), false, Precision::float32);
MOOMILL_BENCH(attention, compact_fused_8, compact(8), true, Precision::float32);
MOOMILL_BENCH(attention, compact_fused_64, compact(64), true, Precision::float32);
MOOMILL_BENCH(attention, compact_bfloat16_64, compact(64), true, Precision::bfloat16);
MOOMILL_BENCH(attention, paper_plain_2, paper(2), false, Precision::float32);
MOOMILL_BENCH(attention, paper_fused_2, paper(2), true, Precision::float32);
MOOMILL_BENCH(attention, paper_bfloat16_2, paper(2), true, Precision::bfloat16);
MOOMILL_BENCH(head, compact_plain_64, compact(64), false, Precision::float32);
MOOMILL_BENCH(head, compact_fused_64, compact(64), true, Precision::float32);
MOOMILL_BENCH(head, compact_bfloat16_64, compact(64), true, Precision::bfloat16);
MOOMILL_BENCH(head, paper_plain_4, paper(4), false, Precision::float32);
MOOMILL_BENCH(head, paper_fused_4, paper(4), true, Precision::float32);
MOOMILL_BENCH(head, paper_bfloat16_4, paper(4), true, Precision::bfloat16);
MOOMILL_BENCH(nearest, compact_64, compact(64));

int main(int argc, char** argv) {
  keep_memory_mapped();  // as netepu does
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
}
