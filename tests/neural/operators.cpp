// Fused operators against straightforward LibTorch that materialises every pair, and against finite differences.
#include "neural/operators.h"

#include <cmath>
#include <functional>

#include "generator/core/error.h"
#include "neural/kernels/cpu.h"
#include "neural/operator_tools.h"
#include "tests/neural/doctest_torch.h"
#include "tests/neural/plain_operators.h"

using namespace moomill;
using namespace moomill::plain;
using torch::Tensor;

namespace {

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
  const Tensor out = fused_attention(terms), expected = plain::attention(wide);
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
  const Tensor out = fused_head(y, weights), expected = plain::head(wide_y, wide);
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

namespace {

// Central differences of the loss in a few entries of every input (double), against the gradients.
void check_differences(const std::function<Tensor()>& evaluate, const std::vector<Tensor>& inputs) {
  const Tensor weights = loss_weights(evaluate(), 9);
  auto loss = [&] { return (evaluate() * weights).sum(); };
  const auto gradients = torch::autograd::grad({loss()}, inputs);
  const torch::NoGradGuard no_grad;
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    CAPTURE(i);
    double* entry = inputs[i].data_ptr<double>();
    const std::int64_t count = inputs[i].numel(), stride = std::max<std::int64_t>(1, count / 17);
    for (std::int64_t k = 0; k < count; k += stride) {
      const double before = entry[k], step = 1e-6;
      entry[k] = before + step;
      const double up = loss().item<double>();
      entry[k] = before - step;
      const double down = loss().item<double>();
      entry[k] = before;
      const double found = gradients[i].reshape({-1})[k].item<double>();
      CHECK(found == doctest::Approx((up - down) / (2 * step)).epsilon(1e-6).scale(1));
    }
  }
}

// Outputs and gradients with a number of threads.
template <class Run>
std::vector<Tensor> with_threads(int threads, Run run) {
  const int before = at::get_num_threads();
  at::set_num_threads(threads);
  auto tensors = run();
  at::set_num_threads(before);
  return tensors;
}

template <class Run>
void check_same_bits(Run run) {
  const auto one = with_threads(1, run);
  for (const int threads : {2, 3}) {
    const auto more = with_threads(threads, run);
    for (std::size_t i = 0; i < one.size(); ++i) {
      CAPTURE(i);
      CHECK(at::equal(one[i], more[i]));
    }
  }
}

}  // namespace

TEST_CASE("gradients of fused attention in double equal finite differences") {
  for (const Sizes& s : {Sizes{.frames = 2, .queries = 5, .keys = 6, .neighbours = 3, .components = 2, .channels = 7},
                         Sizes{.frames = 1,
                         .queries = 3,
                         .keys = 4,
                         .neighbours = 0,
                         .channels = 18,
                         .extra = false,
                         .shared_query = true}}) {
    const AttentionTerms terms = random_terms(s, at::kDouble, 20);
    CHECK(worst(fused_attention(terms), plain::attention(terms)) < 1e-13);
    check_differences([&] { return fused_attention(terms); }, differentiable(terms));
  }
}

TEST_CASE("gradients of the fused head in double equal finite differences") {
  for (const int blocks : {1, 3}) {
    const HeadWeights weights = random_head(5, 21, blocks, 3, at::kDouble, 21);
    const Tensor y = Dice(22, at::kDouble).normal({9, 5});
    CHECK(worst(fused_head(y, weights), plain::head(y, weights)) < 1e-13);
    auto inputs = differentiable(weights);
    inputs.push_back(y);
    check_differences([&] { return fused_head(y, weights); }, inputs);
  }
}

TEST_CASE("fused operators give the same bits for any number of threads") {
  for (const int frames : {1, 3, 37}) {
    CAPTURE(frames);
    for (const bool shared : {false, true}) {
      const AttentionTerms terms = random_terms(
          {.frames = frames, .queries = 201, .keys = 11, .neighbours = 5, .shared_query = shared}, at::kFloat, 30);
      check_same_bits([&] {
        const Tensor out = fused_attention(terms);
        auto tensors = gradients_of(out, differentiable(terms), 31);
        tensors.push_back(out);
        return tensors;
      });
    }
  }
  const HeadWeights weights = random_head(32, 48, 2, 3, at::kFloat, 32);
  const Tensor y = Dice(33, at::kFloat).normal({5000, 32});
  check_same_bits([&] {
    const Tensor out = fused_head(y, weights);
    auto inputs = differentiable(weights);
    inputs.push_back(y);
    auto tensors = gradients_of(out, inputs, 34);
    tensors.push_back(out);
    return tensors;
  });
}

TEST_CASE("fused attention computes only the gradients asked for, each as if all were") {
  const AttentionTerms all = random_terms({.queries = 90, .channels = 48}, at::kFloat, 40);
  const auto truth = gradients_of(fused_attention(all), differentiable(all), 41);
  for (std::size_t wanted = 0; wanted < truth.size(); ++wanted) {
    CAPTURE(wanted);
    AttentionTerms some = all;
    std::size_t i = 0;
    Tensor input;
    for (Tensor* tensor : {&some.query, &some.key, &some.value, &some.logit_code, &some.value_code, &some.mix,
                           &some.query_position, &some.key_position, &some.extra_key, &some.extra_value}) {
      *tensor = tensor->detach();
      if (i++ == wanted) input = tensor->set_requires_grad(true);
    }
    CHECK(at::equal(gradients_of(fused_attention(some), {input}, 41)[0], truth[wanted]));
  }
}

TEST_CASE("fused operators on nothing give nothing, and gradients of zero") {
  AttentionTerms terms = random_terms({.queries = 0}, at::kFloat, 50);
  Tensor out = fused_attention(terms);
  CHECK(out.sizes() == at::IntArrayRef({2, 0, 32}));
  for (const Tensor& gradient : torch::autograd::grad({out.sum()}, differentiable(terms)))
    CHECK(gradient.abs().sum().item<double>() == 0);
  terms = random_terms({.frames = 0}, at::kFloat, 51);
  CHECK(fused_attention(terms).sizes() == at::IntArrayRef({0, 7, 32}));

  const HeadWeights weights = random_head(16, 16, 2, 3, at::kFloat, 52);
  const Tensor y = at::zeros({0, 16}).set_requires_grad(true);
  out = fused_head(y, weights);
  CHECK(out.sizes() == at::IntArrayRef({0, 3}));
  for (const Tensor& gradient : torch::autograd::grad({out.sum()}, differentiable(weights)))
    CHECK(gradient.abs().sum().item<double>() == 0);
  CHECK(nearest_keys(at::zeros({2, 0, 2}), at::zeros({2, 5, 2}), 3).sizes() == at::IntArrayRef({2, 0, 3}));
}

TEST_CASE("fused attention with coincident and far positions") {
  with_each_instruction_set([] {
    // Differences that float holds exactly, so that only the code itself can be wrong; below 1000 the fast way, above
    // the slow.
    for (const double reach : {0.0, 400.0, 9e5}) {
      CAPTURE(reach);
      AttentionTerms terms = random_terms({.queries = 50, .keys = 12, .neighbours = 7, .channels = 32}, at::kFloat, 60);
      const double grid = reach > 1000 ? 0.25 : 1.0 / 64;
      auto place = [&](const Tensor& like, std::uint64_t seed) {
        const auto generator = at::detail::createCPUGenerator(seed);
        return (((at::rand(like.sizes(), generator) * 2 - 1) * (reach / grid)).round() * grid).set_requires_grad(true);
      };
      terms.query_position = place(terms.query_position, 61);
      terms.key_position = place(terms.key_position, 62);
      const torch::NoGradGuard no_grad;  // rows that multiply the difference itself
      for (const Tensor& code : {terms.logit_code, terms.value_code}) code.narrow(0, 0, 3).div_(std::max(1.0, reach));
      const AttentionTerms wide = as_double(terms);
      CHECK(worst(fused_attention(terms), plain::attention(wide)) < 1e-5);
    }
    AttentionTerms terms = random_terms({.channels = 32}, at::kFloat, 63);
    terms.key_position = at::zeros({2, 9, 3}).set_requires_grad(true);
    terms.query_position = at::zeros({2, 7, 3}).set_requires_grad(true);
    const AttentionTerms wide = as_double(terms);
    const auto found = gradients_of(fused_attention(terms), differentiable(terms), 64);
    const auto truth = gradients_of(plain::attention(wide), differentiable(wide), 64);
    for (std::size_t i = 0; i < truth.size(); ++i) CHECK(worst(found[i], truth[i]) < 1e-4);
  });
}

TEST_CASE("logits of ten thousands neither overflow nor vanish wrongly") {
  with_each_instruction_set([] {
    // Whole numbers through a mix of one entry per row: float computes the logits exactly.
    AttentionTerms terms = random_terms({.queries = 30, .keys = 9, .neighbours = 0, .channels = 16}, at::kFloat, 70);
    const torch::NoGradGuard no_grad;
    terms.logit_code.zero_();
    for (Tensor* tensor : {&terms.query, &terms.key, &terms.extra_key}) tensor->copy_((*tensor * 2).round());
    terms.mix.copy_(at::eye(16) * at::tensor({1e4, -1e4, 3e3, -1.0}).repeat({4}).unsqueeze(1));
    for (const Tensor& tensor : differentiable(terms)) tensor.set_requires_grad(true);
    const AttentionTerms wide = as_double(terms);
    const at::AutoGradMode with_grad(true);
    const Tensor out = fused_attention(terms), expected = plain::attention(wide);
    CHECK(worst(out, expected) < 1e-5);
    // Sums over keys of gradients that cancel (the query's) are as bad as in plain float, not worse.
    const auto found = gradients_of(out, differentiable(terms), 71),
               truth = gradients_of(expected, differentiable(wide), 71);
    const auto plain_float = gradients_of(plain::attention(terms), differentiable(terms), 71);
    for (std::size_t i = 0; i < truth.size(); ++i) {
      CAPTURE(i);
      CHECK(worst(found[i], truth[i]) < 1e-4 + 2 * worst(plain_float[i], truth[i]));
    }
  });
}

TEST_CASE("NaN and infinity in an input come out where they do in plain LibTorch") {
  with_each_instruction_set([] {
    for (const double bad : {double(NAN), double(INFINITY), -double(INFINITY)})
      for (int input = 0; input < 10; ++input) {
        CAPTURE(bad);
        CAPTURE(input);
        // The extra key's code is multiplied like any other here: zero times infinity would be NaN.
        if (std::isinf(bad) && (input == 3 || input == 4)) continue;
        const AttentionTerms terms =
            random_terms({.queries = 9, .keys = 5, .neighbours = 2, .channels = 16}, at::kFloat, 80);
        const Tensor tensor = differentiable(terms)[input];
        {
          const torch::NoGradGuard no_grad;
          tensor.view({-1})[tensor.numel() / 2] = bad;
        }
        const Tensor out = fused_attention(terms), expected = plain::attention(terms);
        CHECK(at::equal(out.isfinite(), expected.isfinite()));
        CHECK((out - expected).nan_to_num(0, 0, 0).abs().max().item<double>() < 1e-4);
        gradients_of(out, differentiable(terms), 81);  // comes back
      }
    const HeadWeights weights = random_head(16, 16, 2, 3, at::kFloat, 82);
    const Tensor y = Dice(83, at::kFloat).normal({40, 16}).detach();
    y[7][3] = NAN;
    const Tensor out = fused_head(y, weights);
    CHECK(at::equal(out.isnan(), plain::head(y, weights).isnan()));
    CHECK(out.isnan().any(1).sum().item<int>() == 1);
  });
}

TEST_CASE("nearest keys") {
  Dice dice(90, at::kFloat);
  for (const int n : {1, 4, 13}) {
    CAPTURE(n);
    const Tensor queries = dice.normal({3, 2000, 2}).detach(), keys = dice.normal({3, 13, 2}).detach();
    const Tensor found = nearest_keys(queries, keys, n);
    const Tensor distance = (queries.unsqueeze(2) - keys.unsqueeze(1)).square().sum(3);
    const Tensor expected = std::get<1>(distance.sort(true, 2, false)).narrow(2, 0, n).to(at::kInt);
    CHECK((found.scalar_type() == at::kInt));
    CHECK(at::equal(found, expected));
  }
  SUBCASE("ties go by index, NaN last, infinity before NaN") {
    const Tensor keys = at::tensor({1.0, double(NAN), -1.0, double(INFINITY), 1.0, 0.0}).view({1, 6, 1});
    const Tensor found = nearest_keys(at::zeros({1, 1, 1}, at::kDouble), keys, 6);
    CHECK(at::equal(found.view({-1}), at::tensor({5, 0, 2, 4, 3, 1}, at::kInt)));
    const Tensor lost = nearest_keys(at::full({1, 1, 1}, NAN, at::kDouble), keys, 3);
    CHECK(at::equal(lost.view({-1}), at::tensor({0, 1, 2}, at::kInt)));
  }
}

TEST_CASE("fused operators refuse what does not fit") {
  const AttentionTerms good = random_terms({}, at::kFloat, 100);
  auto refused = [&](auto change) {
    AttentionTerms terms = good;
    change(terms);
    CHECK_THROWS_AS(fused_attention(terms), std::logic_error);
  };
  refused([](AttentionTerms& t) { t.mix = t.mix.to(at::kDouble); });
  refused([](AttentionTerms& t) { t.value = t.value.narrow(1, 0, 3); });
  refused([](AttentionTerms& t) { t.extra_value = Tensor(); });
  refused([](AttentionTerms& t) { t.neighbours = t.neighbours + 6; });
  refused([](AttentionTerms& t) { t.neighbours = t.neighbours - 1; });
  refused([](AttentionTerms& t) { t.neighbours = t.neighbours.to(at::kLong); });
  const AttentionTerms odd = random_terms({.channels = 24}, at::kFloat, 101);
  CHECK_THROWS_AS(fused_attention(odd), std::logic_error);
  const Tensor y = at::zeros({3, 16});
  CHECK_THROWS_AS(fused_head(y, random_head(16, 16, 1, 17, at::kFloat, 102)), std::logic_error);
  CHECK_THROWS_AS(fused_head(y, random_head(32, 16, 1, 1, at::kFloat, 103)), std::logic_error);
  CHECK_THROWS_AS(nearest_keys(at::zeros({1, 2, 2}), at::zeros({1, 3, 2}), 4), std::logic_error);
}

TEST_CASE("bfloat16 products stay near float, and are refused where the processor has none") {
  const AttentionTerms terms = random_terms(
      {.frames = 3, .queries = 61, .keys = 25, .neighbours = 12, .components = 2, .channels = 80}, at::kFloat, 110);
  const HeadWeights weights = random_head(48, 80, 3, 3, at::kFloat, 111);
  const Tensor y = Dice(112, at::kFloat).normal({299, 48});
  limit_instruction_set(InstructionSet::avx2);
  CHECK(!has_bfloat16());
  CHECK_THROWS_AS(fused_attention(terms, Precision::bfloat16), InputError);
  CHECK_THROWS_AS(fused_head(y, weights, Precision::bfloat16), InputError);
  limit_instruction_set(InstructionSet::avx512);
  if (!has_bfloat16()) return;
  // A factor of bfloat16 is off by up to 2^-9; sums of many average that out. Gradients are off by more: some ReLUs of
  // the deep head switch.
  auto compare = [](const Tensor& half, const Tensor& full, const std::vector<Tensor>& inputs) {
    CHECK(worst(half, full) < 0.02);
    CHECK(worst(half, full) > 1e-6);  // it is not float
    CHECK((half - full).norm().item<double>() < 0.004 * full.norm().item<double>());
    const auto found = gradients_of(half, inputs, 113), truth = gradients_of(full, inputs, 113);
    for (std::size_t i = 0; i < truth.size(); ++i) {
      CAPTURE(i);
      CHECK((found[i] - truth[i]).norm().item<double>() < 0.1 * truth[i].norm().item<double>());
    }
  };
  compare(fused_attention(terms, Precision::bfloat16), fused_attention(terms), differentiable(terms));
  auto inputs = differentiable(weights);
  inputs.push_back(y);
  compare(fused_head(y, weights, Precision::bfloat16), fused_head(y, weights), inputs);
  // Everything a float holds has a place in bfloat16, and NaN stays NaN.
  const torch::NoGradGuard no_grad;
  terms.query[1][0] = NAN;
  CHECK(fused_attention(terms, Precision::bfloat16).isnan().any(2).sum().item<int>() == 1);
}

TEST_CASE("what is kept for the backward pass changes no bit, wherever it ends") {
  const AttentionTerms terms = random_terms(
      {.frames = 5, .queries = 30, .keys = 12, .neighbours = 6, .components = 2, .channels = 64}, at::kFloat, 120);
  const HeadWeights weights = random_head(32, 64, 3, 2, at::kFloat, 121);
  const Tensor y = Dice(122, at::kFloat).normal({700, 32});
  auto head_inputs = differentiable(weights);
  head_inputs.push_back(y);
  const std::int64_t before = most_kept_bytes;
  auto gradients = [&](std::int64_t bytes) {
    most_kept_bytes = bytes;
    auto all = gradients_of(fused_attention(terms), differentiable(terms), 123);
    for (const Tensor& gradient : gradients_of(fused_head(y, weights), head_inputs, 124)) all.push_back(gradient);
    most_kept_bytes = before;
    return all;
  };
  const auto nothing = gradients(0);
  // Two of five frames (30 x 7 x 64 floats each); of the head's tiles those that half of it holds; everything.
  for (const std::int64_t bytes : {std::int64_t{110'000}, std::int64_t{1'200'000}, before}) {
    CAPTURE(bytes);
    const auto some = gradients(bytes);
    for (std::size_t i = 0; i < nothing.size(); ++i) {
      CAPTURE(i);
      CHECK(at::equal(nothing[i], some[i]));
    }
  }
}
