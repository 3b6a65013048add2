#pragma once
// Training of both stages. One loop (run_training) for all; a stage says what a step computes and how it is validated.
//
// The folder of a run holds
//   model.netepu    the best model so far, by the validation criterion
//   state.netepu    weights, optimiser and position after the last saved step; a run started again goes on from it, bit for bit
//   scalars.csv     a line per validation: epoch, step, seconds of training, rate, losses, validation figures
//   curves.svg      the same as a picture; error.svg: validation figures against run time
//   config.json     the configuration as resolved
#include <atomic>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "neural/checkpoint.h"
#include "neural/samples.h"

namespace moomill {

using Scalars = std::vector<std::pair<std::string, double>>;  // in a fixed order

struct TrainingControl {
  std::atomic<bool>* stop = nullptr;             // set: the run saves and ends after the step in flight
  std::function<void(const std::string&)> log;   // a line of progress
  Evaluation evaluation;                         // plain or fused, float or bfloat16
  torch::Device device = torch::kCPU;            // where the networks and batches live; the fused operators know the CPU only
  std::int64_t max_steps = 0;                    // of this call, for tests; 0: to the end
  bool profile = false;                          // log what a step spends on drawing, forward and backward, updating
};

enum class TrainingEnd { finished, stopped };

// Trains the geometry on the dataset's training split into folder `out`. RunError when the run diverges: it names epoch,
// step and the term that is not finite; the last saved state stays.
TrainingEnd train_geometry(const SampleSource& source, const NetepuConfig& config, const std::filesystem::path& out,
                           const TrainingControl& control);

// Trains the texture on all coats of the source, with the geometry of `geometry_model` frozen.
TrainingEnd train_texture(const SampleSource& source, const NetepuConfig& config, const std::filesystem::path& geometry_model,
                          const std::filesystem::path& out, const TrainingControl& control);

// What the geometry networks say of a batch's points.
struct GeometryPrediction {
  Pose3d pose;
  torch::Tensor silhouette;  // [B, S] logits
  torch::Tensor depth;       // [B, P], in units of the keypoints' depth range
  torch::Tensor nnopcs;      // [B, P, 3]; undefined without the head
};
GeometryPrediction predict(GeometryNetwork& network, const Batch& batch);

// The weighted terms of the geometry loss, in this order in scalars.csv: silhouette, keypoints, depth, code, nnopcs.
struct GeometryLosses {
  torch::Tensor silhouette, keypoints, depth, code, nnopcs;  // nnopcs is undefined without the head
  torch::Tensor total() const;
};
GeometryLosses geometry_losses(const GeometryPrediction& prediction, const Batch& batch, const NetepuConfig& config);

// How little the codes of one individual's views agree, against those of the others in the batch: supervised contrastive loss (Khosla et
// al. 2020, its L_out) of code directions at temperature 0.1, mean over the views that have a partner of their coat; 0 where
// none has. codes [B, z], coats B long.
torch::Tensor agreement_loss(const torch::Tensor& codes, const std::vector<int>& coats);

// Of the texture: colour, divergence and agreement (undefined at weight 0); `noise` [B, z] is standard normal, or undefined for
// the mean code.
struct TextureLosses {
  torch::Tensor color, divergence, agreement;
  torch::Tensor total() const { return agreement.defined() ? color + divergence + agreement : color + divergence; }
};
TextureLosses texture_losses(GeometryNetwork& geometry, TextureNetwork& texture, const Batch& batch,
                             const TextureTraining& weights, const torch::Tensor& noise);

// What the frozen geometry says of a batch, once for all that is asked of its texture.
struct FrozenGeometry {
  Pose3d pose;
  torch::Tensor nnopcs;  // [B, P, 3] at the surface points; undefined where the colour head does not see it
};
FrozenGeometry freeze(GeometryNetwork& geometry, const Batch& batch);

// Log-variances are held within this before they are used, so that their exponential stays finite.
inline constexpr double least_logvar = -30, greatest_logvar = 20;

// Learning rate of a step (from 0) of `steps_per_epoch` * epochs.
double rate_of(const RateSchedule& schedule, std::int64_t step, std::int64_t steps_per_epoch, int epochs);

// Standard normal numbers keyed by identity.
torch::Tensor keyed_normal(std::uint64_t key, std::vector<std::int64_t> shape);

}  // namespace moomill
