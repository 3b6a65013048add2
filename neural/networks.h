#pragma once
// The networks of Neural Texture Puppeteer. Shapes: B frames, K keypoints, M query points, d = local_features, z = global_features.
// World metres in, except where said; image positions are (x / width, y / height), a pixel's centre at (i + 0.5) / width.
#include <torch/torch.h>

#include "neural/config.h"
#include "neural/operators.h"

namespace moomill {

// How attention and heads are evaluated. Plain: straightforward LibTorch, any device. Fused: operators.h.
struct Evaluation {
  bool fused = true;
  Precision precision = Precision::float32;
};

// What a pose is to the renderers, independent of the camera.
struct Pose3d {
  torch::Tensor code;       // [B, z]
  torch::Tensor keypoints;  // [B, K, 3], as decoded, in units of 2 reader_radius
  torch::Tensor features;   // [B, K, d]
};

struct CameraBatch {
  torch::Tensor world_to_camera;  // [B, 3, 4], OpenCV axes
  torch::Tensor keypoints_2d;     // [B, K, 2], given keypoints projected, in image units
};

// What a view is to the per-pixel part: everything that is computed once per image.
struct ViewFeatures {
  torch::Tensor positions;   // [B, K, 3]: x, y in image units, depth 0 at the nearest decoded keypoint, 1 at the farthest
  torch::Tensor features;    // [B, K, d]
  torch::Tensor global;      // [B, d]
  torch::Tensor near_depth;  // [B] metres, camera z of the nearest decoded keypoint
  torch::Tensor depth_range; // [B] metres, farthest minus nearest; at least minimum_depth_range
};
inline constexpr double minimum_depth_range = 1e-3;  // metres; so that a flat set of keypoints (K = 1) divides by something

class GeometryNetworkImpl : public torch::nn::Module {
 public:
  explicit GeometryNetworkImpl(const ModelConfig& config);
  Pose3d encode(const torch::Tensor& keypoints);  // [B, K, 3] metres
  ViewFeatures view(const Pose3d& pose, const CameraBatch& camera);
  torch::Tensor attend(const ViewFeatures& view, const torch::Tensor& points);  // [B, M, 2] to [B, M, d]
  torch::Tensor silhouette(const torch::Tensor& features);  // [B, M, d] to logits [B, M]
  torch::Tensor depth(const torch::Tensor& features);       // [B, M], in units of the keypoints' depth range
  torch::Tensor nnopcs(const torch::Tensor& features);      // [B, M, 3]
  // Sub-networks whose gradients are clipped apart: encoder, decoder, renderer.
  std::vector<std::vector<torch::Tensor>> clip_groups();
  Evaluation evaluation;
  const ModelConfig& config() const { return config_; }

 private:
  struct Parts;
  ModelConfig config_;
  std::shared_ptr<Parts> parts_;
};
TORCH_MODULE(GeometryNetwork);

struct TextureCode {
  torch::Tensor mean, logvar;  // [B, z]
};

class TextureNetworkImpl : public torch::nn::Module {
 public:
  explicit TextureNetworkImpl(const ModelConfig& config);
  // images [B, 6 or 3, h, w]: sRGB in [0, 1] masked by the silhouette, then NNOPCS masked likewise.
  TextureCode encode(const torch::Tensor& images);
  // Features of the texture at the decoded keypoints, then seen by a camera. code: [B, z], usually the mean.
  ViewFeatures view(const torch::Tensor& code, const Pose3d& pose, const CameraBatch& camera);
  // [B, M, 2] to sRGB [B, M, 3], not clamped. nnopcs: [B, M, 3] (B may be 1), as the geometry predicts it there; only read where the
  // configuration has surface_octaves.
  torch::Tensor color(const ViewFeatures& view, const torch::Tensor& points, const torch::Tensor& nnopcs);
  std::vector<std::vector<torch::Tensor>> clip_groups();  // encoder, decoder, renderer
  Evaluation evaluation;
  const ModelConfig& config() const { return config_; }

 private:
  struct Parts;
  ModelConfig config_;
  std::shared_ptr<Parts> parts_;
};
TORCH_MODULE(TextureNetwork);

std::int64_t count_parameters(const torch::nn::Module& module);

}  // namespace moomill
