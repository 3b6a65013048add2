// AdamW in one pass against LibTorch's.
#include "neural/adamw.h"

#include "tests/neural/doctest_torch.h"

using namespace moomill;

TEST_CASE("AdamW in one pass steps as LibTorch's, and goes on from its state") {
  torch::manual_seed(5);
  std::vector<torch::Tensor> ours, theirs;
  for (const std::int64_t size : {1, 7, 200'003}) {
    ours.push_back(torch::randn({size}).set_requires_grad(true));
    theirs.push_back(ours.back().detach().clone().set_requires_grad(true));
  }
  ours.push_back(torch::ones({3}).set_requires_grad(true));  // has no gradient
  theirs.push_back(torch::ones({3}).set_requires_grad(true));
  const auto options = torch::optim::AdamWOptions(3e-2).weight_decay(0.1);
  torch::optim::AdamW fast(ours, options), reference(theirs, options);
  for (int step = 0; step < 6; ++step) {
    for (std::size_t i = 0; i < 3; ++i) {
      ours[i].mutable_grad() = torch::randn_like(ours[i]) * (i == 1 ? 1e-6 : 1.0);
      theirs[i].mutable_grad() = ours[i].grad().clone();
    }
    if (step == 3)
      fast.step();  // either takes over from the other
    else
      adamw_step(fast);
    reference.step();
    for (std::size_t i = 0; i < ours.size(); ++i) CHECK(torch::allclose(ours[i], theirs[i], 1e-5, 5e-6));
  }
  CHECK((ours[2] - theirs[2]).abs().max().item<double>() < 5e-6);  // of numbers up to 5
  CHECK(torch::equal(ours[3], torch::ones({3})));
}

TEST_CASE("AdamW gives the same bits for any number of threads, and leaves doubles to LibTorch") {
  torch::manual_seed(6);
  const torch::Tensor start = torch::randn({300'001}), gradient = torch::randn({300'001});
  std::vector<torch::Tensor> results;
  const int before = at::get_num_threads();
  for (const int threads : {1, 2, 3}) {
    at::set_num_threads(threads);
    torch::Tensor p = start.clone().set_requires_grad(true);
    torch::optim::AdamW optimiser({p}, torch::optim::AdamWOptions(1e-2));
    for (int step = 0; step < 2; ++step) {
      p.mutable_grad() = gradient.clone();
      adamw_step(optimiser);
    }
    results.push_back(p.detach());
  }
  at::set_num_threads(before);
  CHECK(torch::equal(results[0], results[1]));
  CHECK(torch::equal(results[0], results[2]));

  torch::Tensor p = torch::ones({3}, torch::kDouble).set_requires_grad(true);
  torch::optim::AdamW optimiser({p}, torch::optim::AdamWOptions(1e-2));
  p.mutable_grad() = torch::ones({3}, torch::kDouble);
  adamw_step(optimiser);
  CHECK(p[0].item<double>() == doctest::Approx(0.99 - 1e-4));  // decay, then a step of the rate
}
