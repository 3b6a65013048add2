// Whole training steps of both stages (forward, backward, optimiser) with plain and fused operators, on random batches,
// at the sizes of the configurations that ship.
#include <benchmark/benchmark.h>
#include <torch/torch.h>

#include "neural/adamw.h"
#include "neural/training.h"

using namespace moomill;

namespace {

torch::Tensor random_tensor(std::vector<std::int64_t> sizes) {
  return torch::rand(sizes);
}

Batch random_batch(const NetepuConfig& config, int frames, int silhouette_points, int surface_points, int width,
                   int height) {
  const int k = config.model.keypoints;
  Batch b;
  b.views.resize(frames);
  b.keypoints = random_tensor({frames, k, 3});
  b.noisy_keypoints = b.keypoints + 0.003;
  b.keypoints_2d = random_tensor({frames, k, 2});
  b.world_to_camera = torch::eye(3, 4).expand({frames, 3, 4}).contiguous();
  b.near_depth = torch::ones({frames});
  b.depth_range = torch::ones({frames});
  b.silhouette_points = random_tensor({frames, silhouette_points, 2});
  b.silhouette = random_tensor({frames, silhouette_points}).round();
  b.surface_points = random_tensor({frames, surface_points, 2});
  b.depth = random_tensor({frames, surface_points});
  b.nnopcs = random_tensor({frames, surface_points, 3});
  b.color = random_tensor({frames, surface_points, 3});
  if (width > 0) b.images = random_tensor({frames, 6, height, width});
  return b;
}

NetepuConfig shipped(const char* name) {
  return read_config(std::filesystem::path(MOOMILL_SOURCE_DIR) / "neural/configs" / (std::string(name) + ".toml"));
}

Evaluation evaluation_of(bool fused, Precision precision) {
  return {.fused = fused, .precision = precision};
}

bool prepare(benchmark::State& state, Precision precision) {
  at::set_num_threads(int(state.range(0)));
  at::globalContext().setFlushDenormal(true);
  torch::manual_seed(1);
  if (precision == Precision::float32 || has_bfloat16()) return true;
  state.SkipWithError("no AVX512-BF16");
  return false;
}

void geometry_step(benchmark::State& state, const char* name, int frames, bool fused, Precision precision) {
  if (!prepare(state, precision)) return;
  const NetepuConfig config = shipped(name);
  const GeometryTraining& g = config.geometry;
  GeometryNetwork network(config.model);
  network->evaluation = evaluation_of(fused, precision);
  torch::optim::AdamW optimiser(network->parameters(), torch::optim::AdamWOptions(1e-4));
  const Batch batch = random_batch(config, frames, g.silhouette_points, g.surface_points, 0, 0);
  for (auto _ : state) {
    optimiser.zero_grad();
    geometry_losses(predict(network, batch), batch, config).total().backward();
    fused ? adamw_step(optimiser) : (void)optimiser.step();
  }
}

void texture_step(benchmark::State& state, const char* name, int frames, bool fused, Precision precision) {
  if (!prepare(state, precision)) return;
  const NetepuConfig config = shipped(name);
  const TextureTraining& t = config.texture;
  GeometryNetwork geometry(config.model);
  geometry->eval();
  TextureNetwork texture(config.model);
  geometry->evaluation = texture->evaluation = evaluation_of(fused, precision);
  torch::optim::AdamW optimiser(texture->parameters(), torch::optim::AdamWOptions(1e-4));
  const Batch batch = random_batch(config, frames, 0, t.surface_points, t.encoder.width, t.encoder.height);
  const torch::Tensor noise = torch::randn({frames, config.model.global_features});
  for (auto _ : state) {
    optimiser.zero_grad();
    texture_losses(geometry, texture, batch, t, noise).total().backward();
    fused ? adamw_step(optimiser) : (void)optimiser.step();
  }
}

}  // namespace

#define MOOMILL_BENCH(name, ...)       \
  BENCHMARK_CAPTURE(name, __VA_ARGS__) \
      ->Arg(1)                         \
      ->Arg(2)                         \
      ->Unit(benchmark::kMillisecond)  \
      ->UseRealTime()                  \
      ->MeasureProcessCPUTime()
MOOMILL_BENCH(geometry_step, compact_plain_64, "compact", 64, false, Precision::float32);
MOOMILL_BENCH(geometry_step, compact_fused_64, "compact", 64, true, Precision::float32);
MOOMILL_BENCH(geometry_step, compact_bfloat16_64, "compact", 64, true, Precision::bfloat16);
MOOMILL_BENCH(geometry_step, paper_plain_8, "paper", 8, false, Precision::float32);
MOOMILL_BENCH(geometry_step, paper_fused_8, "paper", 8, true, Precision::float32);
MOOMILL_BENCH(geometry_step, paper_bfloat16_8, "paper", 8, true, Precision::bfloat16);
MOOMILL_BENCH(texture_step, compact_plain_64, "compact", 64, false, Precision::float32);
MOOMILL_BENCH(texture_step, compact_fused_64, "compact", 64, true, Precision::float32);
MOOMILL_BENCH(texture_step, compact_bfloat16_64, "compact", 64, true, Precision::bfloat16);
