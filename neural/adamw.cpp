#include "neural/adamw.h"

#include <ATen/Parallel.h>

#include <cmath>

namespace moomill {

namespace {

using torch::Tensor;

// Of one parameter at one step, as LibTorch has them.
struct Factors {
  float keep;  // 1 - rate x weight decay
  float beta1, beta2;
  float rate;                // over the first bias correction
  float root_of_correction;  // of the second bias
  float epsilon;
};

void update(float* parameter, const float* gradient, float* mean, float* square, std::int64_t count, const Factors& f) {
  const float rest1 = 1 - f.beta1, rest2 = 1 - f.beta2;
  for (std::int64_t i = 0; i < count; ++i) {
    const float g = gradient[i];
    mean[i] = mean[i] * f.beta1 + rest1 * g;
    square[i] = square[i] * f.beta2 + rest2 * g * g;
    parameter[i] = parameter[i] * f.keep - f.rate * mean[i] / (std::sqrt(square[i]) / f.root_of_correction + f.epsilon);
  }
}

bool is_plain_float(const Tensor& t) {
  return t.device().is_cpu() && t.scalar_type() == at::kFloat && t.layout() == at::kStrided && t.is_contiguous();
}

bool can_update(torch::optim::AdamW& optimiser) {
  for (auto& group : optimiser.param_groups()) {
    if (static_cast<torch::optim::AdamWOptions&>(group.options()).amsgrad()) return false;
    for (const Tensor& p : group.params())
      if (!is_plain_float(p) || (p.grad().defined() && !is_plain_float(p.grad()))) return false;
  }
  return true;
}

}  // namespace

void adamw_step(torch::optim::AdamW& optimiser) {
  const torch::NoGradGuard no_grad;
  if (!can_update(optimiser)) {
    optimiser.step();
    return;
  }
  for (auto& group : optimiser.param_groups()) {
    const auto& options = static_cast<torch::optim::AdamWOptions&>(group.options());
    const auto [beta1, beta2] = options.betas();
    for (Tensor& p : group.params()) {
      if (!p.grad().defined()) continue;
      auto& slot = optimiser.state()[c10::guts::to_string(p.unsafeGetTensorImpl())];
      if (!slot) {
        auto fresh = std::make_unique<torch::optim::AdamWParamState>();
        fresh->exp_avg(at::zeros_like(p)).exp_avg_sq(at::zeros_like(p));
        slot = std::move(fresh);
      }
      auto& state = static_cast<torch::optim::AdamWParamState&>(*slot);
      state.step(state.step() + 1);
      Factors f;
      f.keep = float(1 - options.lr() * options.weight_decay());
      f.beta1 = float(beta1), f.beta2 = float(beta2);
      f.rate = float(options.lr() / (1 - std::pow(beta1, double(state.step()))));
      f.root_of_correction = float(std::sqrt(1 - std::pow(beta2, double(state.step()))));
      f.epsilon = float(options.eps());
      auto* const parameter = p.data_ptr<float>();
      auto* const mean = state.exp_avg().data_ptr<float>();
      auto* const square = state.exp_avg_sq().data_ptr<float>();
      const auto* const gradient = p.grad().data_ptr<float>();
      at::parallel_for(0, p.numel(), 1 << 16, [&](std::int64_t begin, std::int64_t end) {
        update(parameter + begin, gradient + begin, mean + begin, square + begin, end - begin, f);
      });
    }
  }
}

}  // namespace moomill
