#pragma once
#include <optional>
// The loop that both stages share.
#include "neural/training.h"

namespace moomill {

// What the loop needs to know of a stage.
struct Stage {
  std::string name;                                  // "geometry" or "texture", also the key in the configuration
  torch::nn::Module* module = nullptr;               // what is trained
  std::vector<std::vector<torch::Tensor>> groups;    // parameters whose gradients are clipped together
  std::string base;                                  // hash of the trained model it builds on; empty: none
  OptimiserConfig optimiser;
  int epochs = 1, validate_every = 1;
  SampleOptions samples;                             // of the training split
  std::optional<SampleOptions> validation;           // what `validate` draws
  // Forward and backward of a batch; gradients are added to the parameters. Returns the weighted terms.
  std::function<Scalars(const Batch& batch, std::int64_t step)> accumulate;
  std::function<Scalars()> validate;                 // figures; the first decides which model is best (least)
  std::function<void(const std::filesystem::path& file, const nlohmann::json& provenance)> save_best;
};

TrainingEnd run_training(const SampleSource& source, const NetepuConfig& config, Stage& stage,
                         const std::filesystem::path& out, const TrainingControl& control);

}  // namespace moomill
