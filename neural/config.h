#pragma once
// Configuration of netepu: sizes of the networks, and how they are trained. Defaults are those of NeTePu on cows (Waldmann et
// al., WACV-W 2024, and its public code); files in neural/configs/ change some of them. Every number is written into checkpoints.
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace moomill {

struct ModelConfig {
  int keypoints = 25;            // K; must be the dataset's
  int local_features = 256;      // d_f; a multiple of 16
  int global_features = 1024;    // d_z
  int head_width = 256;          // hidden width of every head; a multiple of 16
  int head_blocks = 5;           // residual blocks of every head
  int encoder_blocks = 4;        // attention + perceptron, after the first attention
  int keypoint_bottleneck = 128; // of the decoder's keypoint branch
  int near_neighbours = 8;       // of the first self-attention of decoder and renderer
  int neighbours = 20;           // keypoints a query pixel attends to, by image distance; K or more: all
  double position_scale = 4;     // on keypoint positions inside encoder and decoder
  bool position_gradient = true; // the decoded keypoints also learn through the positions that later attention sees (public code)
  double reader_radius = 1.5;    // metres; keypoints are divided by twice this
  bool nnopcs = true;            // an NNOPCS head, and NNOPCS as input of the texture encoder
  int surface_octaves = 0;       // of the predicted NNOPCS at a pixel, which the colour head also sees; 0: it does not (published)
  std::vector<int> image_channels{16, 32, 64, 128, 256};  // stages of the texture encoder, the first also its stem
  int image_blocks = 2;          // residual blocks a stage
  bool code_activation = true;   // leaky ReLU on mean and log-variance, as in the public code; the paper has none
  bool operator==(const ModelConfig&) const = default;
};

// How the learning rate goes: multiplied by decay_factor every decay_epochs (0: never), and cosine-annealed to
// final_rate_share of it at the last step when that is below 1; warmup_steps rise linearly.
struct RateSchedule {
  double rate = 5e-4;
  double decay_factor = 0.2;
  int decay_epochs = 500;
  int warmup_steps = 0;
  double final_share = 1;
};

struct OptimiserConfig {
  RateSchedule schedule;
  double weight_decay = 0.005;
  double clip_norm = 1;  // per network; 0: none
};

struct GeometryTraining {
  OptimiserConfig optimiser;
  int batch = 64;                // frames a step, one random camera each
  int epochs = 2000;             // an epoch shows every training frame views_per_frame times
  int views_per_frame = 1;       // cameras drawn per frame and epoch
  int validate_every = 5;        // epochs
  int silhouette_points = 1500;
  int surface_points = 500;
  double near_sigma = 0.0125, far_sigma = 0.125;  // of silhouette points about the boundary, share of the image's sides
  double keypoint_noise_m = 0.003;
  bool turn_cameras = true;      // shift of the ring by k x 45 degrees, keypoints turned alike
  double silhouette_weight = 3, keypoint_weight = 2, depth_weight = 1, code_weight = 0.0625, nnopcs_weight = 1;
  bool squared_depth = false;    // NePu: mean squared depth error instead of the 2-norm over a frame's points
};

// What the texture encoder is shown.
struct EncoderInput {
  int width = 0, height = 0;     // pixels; 0: as rendered
  bool crop = false;             // the animal's window alone (mask_window), instead of the whole picture (published)
};

struct TextureTraining {
  OptimiserConfig optimiser;
  int batch = 64;
  int micro_batch = 0;           // views a forward pass holds at once; 0: the whole batch
  int epochs = 2000;
  int views_per_frame = 1;
  int validate_every = 5;
  int surface_points = 500;
  double keypoint_noise_m = 0.003;
  bool turn_cameras = true;
  double color_weight = 5, divergence_weight = 1e-8;
  double agreement_weight = 0;   // of agreement_loss: codes of one individual's views near each other (0: published)
  EncoderInput encoder;          // keys encoder_width, encoder_height, encoder_crop
};

struct NetepuConfig {
  ModelConfig model;
  GeometryTraining geometry;
  TextureTraining texture;
  std::uint64_t seed = 1;
};

// InputError with file and line for an unknown key, a wrong type or a range that makes no sense.
NetepuConfig read_config(const std::filesystem::path& file);

nlohmann::json to_json(const ModelConfig& model);
ModelConfig model_from_json(const nlohmann::json& json, const std::string& file);  // InputError names what does not fit
nlohmann::json to_json(const NetepuConfig& config);
NetepuConfig config_from_json(const nlohmann::json& json, const std::string& file);

}  // namespace moomill
