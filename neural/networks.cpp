#include "neural/networks.h"

#include <numbers>

#include "generator/core/error.h"

namespace moomill {
namespace {

using torch::Tensor;
namespace nn = torch::nn;
namespace F = torch::nn::functional;

constexpr int frequency_count = 5;
constexpr int code_blocks = 1 + 2 * frequency_count;  // [d, sin f_0 d, cos f_0 d, ...]
constexpr double leak = 0.1;

// Positional code of differences: [..., D] to [..., 11 D]; frequencies evenly spaced from 1 to 32.
Tensor positional_code(const Tensor& difference) {
  std::vector<Tensor> blocks{difference};
  for (int k = 0; k < frequency_count; ++k) {
    const double f = 1 + 31.0 * k / (frequency_count - 1);
    blocks.push_back(torch::sin(difference * f));
    blocks.push_back(torch::cos(difference * f));
  }
  return torch::cat(blocks, -1);
}

// Rows of a [11 D, d] code matrix that belong to component `c` of D.
Tensor component_rows(const Tensor& code, int c, int dimensions) {
  return code.view({code_blocks, dimensions, code.size(1)}).select(1, c);
}

// values [B, K, d], neighbours int32 [B, M, n] to [B, M, n, d].
Tensor gather_keys(const Tensor& values, const Tensor& neighbours) {
  const auto b = values.size(0), m = neighbours.size(1), n = neighbours.size(2), d = values.size(2);
  const Tensor index = neighbours.to(torch::kLong).view({b, m * n, 1}).expand({b, m * n, d});
  return values.gather(1, index).view({b, m, n, d});
}

// The perceptron of all vector attentions and its projections. Plain and fused evaluation are the same algebra; the fused one
// has the first layer split into a part per query, one per key and one per code (see operators.h).
struct VectorWeights : nn::Module {
  nn::Linear query{nullptr}, key{nullptr}, value{nullptr}, position{nullptr}, first{nullptr}, second{nullptr};
  explicit VectorWeights(int d) {
    query = register_module("query", nn::Linear(nn::LinearOptions(d, d).bias(false)));
    key = register_module("key", nn::Linear(nn::LinearOptions(d, d).bias(false)));
    value = register_module("value", nn::Linear(nn::LinearOptions(d, d).bias(false)));
    position = register_module("position", nn::Linear(3 * code_blocks, d));
    first = register_module("first", nn::Linear(d, d));
    second = register_module("second", nn::Linear(d, d));
  }
  Tensor mix_logits(const Tensor& edges) { return second(torch::relu(first(edges))); }
  Tensor logit_code() { return torch::mm(first->weight, position->weight).t().contiguous(); }
  Tensor value_code() { return position->weight.t().contiguous(); }
};

// Batch norm over frames and keypoints, x [B, K, d]. Channels go first: LibTorch then sums each channel on one thread, in one
// order, while for [N, d] the order depends on the number of threads.
Tensor normalise(nn::BatchNorm1d& norm, const Tensor& x) {
  const Tensor rows = x.reshape({-1, x.size(2)}).t().contiguous().unsqueeze(0);
  return norm(rows).squeeze(0).t().reshape(x.sizes());
}

// Self-attention among keypoints with residual and batch norm. near = 0: all keypoints, else the nearest so many.
struct SelfAttention : nn::Module {
  std::shared_ptr<VectorWeights> w;
  nn::BatchNorm1d norm{nullptr};
  int near;
  SelfAttention(int d, int nearest) : near(nearest) {
    w = register_module("weights", std::make_shared<VectorWeights>(d));
    norm = register_module("norm", nn::BatchNorm1d(d));
  }
  Tensor forward(const Tensor& positions, const Tensor& x, const Evaluation& evaluation) {
    const auto b = x.size(0), k = x.size(1);
    Tensor neighbours;
    if (near > 0 && near < k) {
      torch::NoGradGuard fixed;
      neighbours = evaluation.fused ? nearest_keys(positions.detach(), positions.detach(), near)
                                    : std::get<1>(torch::cdist(positions, positions).topk(near, -1, false)).to(torch::kInt);
    }
    Tensor attended;
    if (evaluation.fused) {
      AttentionTerms t;
      t.query = F::linear(w->query(x) + w->position->bias, w->first->weight, w->first->bias);
      t.key = F::linear(w->key(x), w->first->weight);
      t.value = w->value(x) + w->position->bias;
      t.logit_code = w->logit_code(), t.value_code = w->value_code();
      t.mix = w->second->weight;
      t.query_position = t.key_position = positions.contiguous();
      t.neighbours = neighbours;
      attended = fused_attention(t, evaluation.precision);
    } else {
      if (!neighbours.defined())
        neighbours = torch::arange(k, positions.options().dtype(torch::kInt)).view({1, 1, k}).expand({b, k, k});
      const Tensor code = w->position(positional_code(positions.unsqueeze(2) - gather_keys(positions, neighbours)));
      const Tensor logits = w->mix_logits(w->query(x).unsqueeze(2) - gather_keys(w->key(x), neighbours) + code);
      attended = (torch::softmax(logits, 2) * (gather_keys(w->value(x), neighbours) + code)).sum(2);
    }
    return normalise(norm, attended + x);
  }
};

// Cross-attention of query pixels to keypoints; the global code is the query, and one more key and value.
struct CrossAttention : nn::Module {
  std::shared_ptr<VectorWeights> w;
  nn::Linear global_key{nullptr}, global_value{nullptr};
  int neighbours;
  CrossAttention(int d, int nearest) : neighbours(nearest) {
    w = register_module("weights", std::make_shared<VectorWeights>(d));
    global_key = register_module("global_key", nn::Linear(nn::LinearOptions(d, d).bias(false)));
    global_value = register_module("global_value", nn::Linear(nn::LinearOptions(d, d).bias(false)));
  }
  // points [B, M, 2], positions [B, K, 3] (x, y, depth), features [B, K, d], global [B, d]
  Tensor forward(const Tensor& points, const Tensor& positions, const Tensor& features, const Tensor& global,
                 const Evaluation& evaluation) {
    const auto b = points.size(0), k = positions.size(1);
    const Tensor flat = positions.slice(2, 0, 2).contiguous(), depths = positions.slice(2, 2, 3).contiguous();
    Tensor chosen;
    if (neighbours < k) {
      torch::NoGradGuard fixed;
      chosen = evaluation.fused ? nearest_keys(points, flat.detach(), neighbours)
                                : std::get<1>(torch::cdist(points, flat).topk(neighbours, -1, false)).to(torch::kInt);
    }
    if (evaluation.fused) {
      // The third difference is the keypoint's own depth: its part of the code is one vector per key.
      const Tensor logit_code = w->logit_code(), value_code = w->value_code();
      const Tensor depth_code = positional_code(depths);
      const auto planar = [](const Tensor& code) {
        return code.view({code_blocks, 3, code.size(1)}).slice(1, 0, 2).reshape({2 * code_blocks, code.size(1)});
      };
      const Tensor shift = F::linear(w->position->bias, w->first->weight);
      AttentionTerms t;
      t.query = (F::linear(w->query(global), w->first->weight, w->first->bias) + shift).unsqueeze(1);
      t.key = F::linear(w->key(features), w->first->weight) - torch::matmul(depth_code, component_rows(logit_code, 2, 3));
      t.value = w->value(features) + w->position->bias + torch::matmul(depth_code, component_rows(value_code, 2, 3));
      t.logit_code = planar(logit_code), t.value_code = planar(value_code);
      t.mix = w->second->weight;
      t.query_position = points.contiguous(), t.key_position = flat.detach();
      t.neighbours = chosen;
      t.extra_key = F::linear(global_key(global), w->first->weight) + shift;
      t.extra_value = global_value(global);
      return fused_attention(t, evaluation.precision);
    }
    if (!chosen.defined())
      chosen = torch::arange(k, points.options().dtype(torch::kInt)).view({1, 1, k}).expand({b, points.size(1), k});
    const Tensor near = gather_keys(positions, chosen);
    const Tensor difference = torch::cat({points.unsqueeze(2) - near.slice(3, 0, 2), near.slice(3, 2, 3)}, -1);
    const Tensor code = F::pad(w->position(positional_code(difference)), F::PadFuncOptions({0, 0, 0, 1}));
    const auto with_global = [&](const Tensor& keys, const Tensor& extra) {
      return torch::cat({gather_keys(keys, chosen), extra.view({b, 1, 1, -1}).expand({b, points.size(1), 1, extra.size(1)})}, 2);
    };
    const Tensor keys = with_global(w->key(features), global_key(global));
    const Tensor values = with_global(w->value(features), global_value(global));
    const Tensor logits = w->mix_logits(w->query(global).view({b, 1, 1, -1}) - keys + code);
    return (torch::softmax(logits, 2) * (values + code)).sum(2);
  }
};

// Linear, ReLU, linear, ReLU, residual, batch norm.
struct ElementPerceptron : nn::Module {
  nn::Linear first{nullptr}, second{nullptr};
  nn::BatchNorm1d norm{nullptr};
  explicit ElementPerceptron(int d) {
    first = register_module("first", nn::Linear(d, d));
    second = register_module("second", nn::Linear(d, d));
    norm = register_module("norm", nn::BatchNorm1d(d));
  }
  Tensor forward(const Tensor& x) {
    return normalise(norm, x + torch::relu(second(torch::relu(first(x)))));
  }
};

// A head; its layers are stacked so that one operator takes them all.
struct Head : nn::Module {
  HeadWeights w;
  int outputs;
  Head(int d, int h, int blocks, int output_count) : outputs(output_count) {
    // As LibTorch initialises linear layers: uniform within 1 / sqrt(inputs).
    const auto add = [&](const char* name, std::vector<std::int64_t> shape, int inputs) {
      const double bound = 1 / std::sqrt(static_cast<double>(inputs));
      return register_parameter(name, torch::empty(shape).uniform_(-bound, bound));
    };
    w.in_weight = add("in_weight", {h, d}, d), w.in_bias = add("in_bias", {h}, d);
    w.feature_weight = add("feature_weight", {blocks, h, d}, d), w.feature_bias = add("feature_bias", {blocks, h}, d);
    w.first_weight = add("first_weight", {blocks, h, h}, h), w.first_bias = add("first_bias", {blocks, h}, h);
    w.second_weight = register_parameter("second_weight", torch::zeros({blocks, h, h}));
    w.second_bias = add("second_bias", {blocks, h}, h);
    w.out_weight = add("out_weight", {outputs, h}, h), w.out_bias = add("out_bias", {outputs}, h);
  }
  Tensor forward(const Tensor& features, const Evaluation& evaluation) {  // [..., d] to [..., outputs]
    std::vector<std::int64_t> shape = features.sizes().vec();
    shape.back() = outputs;
    const Tensor y = features.reshape({-1, features.size(-1)});
    if (evaluation.fused) return fused_head(y, w, evaluation.precision).view(shape);
    Tensor net = F::linear(y, w.in_weight, w.in_bias);
    for (int i = 0; i < w.feature_weight.size(0); ++i) {
      net = net + F::linear(y, w.feature_weight[i], w.feature_bias[i]);
      const Tensor hidden = F::linear(torch::relu(net), w.first_weight[i], w.first_bias[i]);
      net = net + F::linear(torch::relu(hidden), w.second_weight[i], w.second_bias[i]);
    }
    return F::linear(torch::relu(net), w.out_weight, w.out_bias).view(shape);
  }
};

// Features of keypoints from a code: three linear layers, three attention blocks.
struct FeatureDecoder : nn::Module {
  nn::Linear first{nullptr}, second{nullptr}, third{nullptr};
  std::vector<std::shared_ptr<SelfAttention>> blocks;
  int keypoints;
  double scale;
  explicit FeatureDecoder(const ModelConfig& c) : keypoints(c.keypoints), scale(c.position_scale) {
    const int z = c.global_features;
    first = register_module("first", nn::Linear(z, 2 * z));
    second = register_module("second", nn::Linear(2 * z, 4 * z));
    third = register_module("third", nn::Linear(4 * z, c.keypoints * c.local_features));
    for (int i = 0; i < 3; ++i)
      blocks.push_back(register_module("attention" + std::to_string(i),
                                       std::make_shared<SelfAttention>(c.local_features, i == 0 ? c.near_neighbours : 0)));
  }
  Tensor forward(const Tensor& code, const Tensor& positions, const Evaluation& evaluation) {
    Tensor x = third(torch::relu(second(torch::relu(first(code))))).view({code.size(0), keypoints, -1});
    for (auto& block : blocks) x = block->forward(positions * scale, x, evaluation);
    return x;
  }
};

// What both renderers begin with: the code narrowed, three attention blocks on image positions, cross-attention.
struct ViewAttention : nn::Module {
  nn::Linear down{nullptr};
  std::vector<std::shared_ptr<SelfAttention>> blocks;
  std::shared_ptr<CrossAttention> cross;
  double unit;  // metres per unit of decoded keypoints
  explicit ViewAttention(const ModelConfig& c) : unit(2 * c.reader_radius) {
    down = register_module("down", nn::Linear(c.global_features, c.local_features));
    for (int i = 0; i < 3; ++i)
      blocks.push_back(register_module("attention" + std::to_string(i),
                                       std::make_shared<SelfAttention>(c.local_features, i == 0 ? c.near_neighbours : 0)));
    cross = register_module("cross", std::make_shared<CrossAttention>(c.local_features, c.neighbours));
  }
  ViewFeatures view(const Tensor& code, const Tensor& keypoints, const Tensor& features, const CameraBatch& camera,
                    const Evaluation& evaluation) {
    ViewFeatures v;
    const Tensor row = camera.world_to_camera.select(1, 2);  // [B, 4]: what gives camera z
    const Tensor z = (keypoints * unit * row.slice(1, 0, 3).unsqueeze(1)).sum(2) + row.slice(1, 3, 4);
    v.near_depth = std::get<0>(z.min(1));
    v.depth_range = (std::get<0>(z.max(1)) - v.near_depth).clamp_min(minimum_depth_range);
    const Tensor depth = (z - v.near_depth.unsqueeze(1)) / v.depth_range.unsqueeze(1);
    v.positions = torch::cat({camera.keypoints_2d, depth.unsqueeze(2)}, 2);
    v.features = features;
    for (auto& block : blocks) v.features = block->forward(v.positions, v.features, evaluation);
    v.global = down(code);
    return v;
  }
  Tensor attend(const ViewFeatures& v, const Tensor& points, const Evaluation& evaluation) {
    return cross->forward(points, v.positions, v.features, v.global, evaluation);
  }
};

// Residual block of two 3 x 3 convolutions (He et al. 2016).
struct ImageBlock : nn::Module {
  nn::Conv2d first{nullptr}, second{nullptr}, shortcut{nullptr};
  nn::BatchNorm2d first_norm{nullptr}, second_norm{nullptr}, shortcut_norm{nullptr};
  ImageBlock(int in, int out, int stride) {
    const auto conv = [](int from, int to, int size, int step) {
      return nn::Conv2d(nn::Conv2dOptions(from, to, size).stride(step).padding(size / 2).bias(false));
    };
    first = register_module("first", conv(in, out, 3, stride));
    first_norm = register_module("first_norm", nn::BatchNorm2d(out));
    second = register_module("second", conv(out, out, 3, 1));
    second_norm = register_module("second_norm", nn::BatchNorm2d(out));
    if (stride != 1 || in != out) {
      shortcut = register_module("shortcut", conv(in, out, 1, stride));
      shortcut_norm = register_module("shortcut_norm", nn::BatchNorm2d(out));
    }
  }
  Tensor forward(const Tensor& x) {
    Tensor y = torch::leaky_relu(first_norm(first(x)), leak);
    y = second_norm(second(y));
    return torch::leaky_relu(y + (shortcut.is_empty() ? x : shortcut_norm(shortcut(x))), leak);
  }
};

// What attention sees of the decoded keypoints. Its positional codes have slopes of a hundred and more, so their gradient can drown
// that of the keypoint loss; a configuration may cut it.
Tensor positions_of(const Pose3d& pose, const ModelConfig& config) {
  return config.position_gradient ? pose.keypoints : pose.keypoints.detach();
}

std::vector<std::vector<Tensor>> groups_of(std::initializer_list<std::vector<std::shared_ptr<nn::Module>>> groups) {
  std::vector<std::vector<Tensor>> out;
  for (const auto& group : groups) {
    out.emplace_back();
    for (const auto& module : group)
      for (const Tensor& p : module->parameters()) out.back().push_back(p);
  }
  return out;
}

}  // namespace

struct GeometryNetworkImpl::Parts {
  nn::Linear embed{nullptr}, code_first{nullptr}, code_second{nullptr};
  std::vector<std::shared_ptr<SelfAttention>> attention;
  std::vector<std::shared_ptr<ElementPerceptron>> perceptrons;
  nn::Linear keypoint_first{nullptr}, keypoint_second{nullptr}, keypoint_third{nullptr};
  std::shared_ptr<FeatureDecoder> decoder;
  std::shared_ptr<ViewAttention> renderer;
  std::shared_ptr<Head> silhouette, depth, nnopcs;
};

GeometryNetworkImpl::GeometryNetworkImpl(const ModelConfig& c) : config_(c), parts_(std::make_shared<Parts>()) {
  Parts& p = *parts_;
  const int d = c.local_features, z = c.global_features, k = c.keypoints;
  // One-hot features through a linear layer are its columns: one row of weights per keypoint.
  p.embed = register_module("encoder_embed", nn::Linear(k, d));
  for (int i = 0; i <= c.encoder_blocks; ++i) {
    p.attention.push_back(register_module("encoder_attention" + std::to_string(i), std::make_shared<SelfAttention>(d, 0)));
    if (i > 0)
      p.perceptrons.push_back(register_module("encoder_perceptron" + std::to_string(i), std::make_shared<ElementPerceptron>(d)));
  }
  p.code_first = register_module("encoder_code_first", nn::Linear(d, z));
  p.code_second = register_module("encoder_code_second", nn::Linear(z, z));
  p.keypoint_first = register_module("decoder_keypoint_first", nn::Linear(z, c.keypoint_bottleneck));
  p.keypoint_second = register_module("decoder_keypoint_second", nn::Linear(c.keypoint_bottleneck, z));
  p.keypoint_third = register_module("decoder_keypoint_third", nn::Linear(z, 3 * k));
  p.decoder = register_module("decoder_features", std::make_shared<FeatureDecoder>(c));
  p.renderer = register_module("renderer", std::make_shared<ViewAttention>(c));
  p.silhouette = register_module("head_silhouette", std::make_shared<Head>(d, c.head_width, c.head_blocks, 1));
  p.depth = register_module("head_depth", std::make_shared<Head>(d, c.head_width, c.head_blocks, 1));
  if (c.nnopcs) p.nnopcs = register_module("head_nnopcs", std::make_shared<Head>(d, c.head_width, c.head_blocks, 3));
}

Pose3d GeometryNetworkImpl::encode(const Tensor& keypoints) {
  Parts& p = *parts_;
  const auto b = keypoints.size(0), k = keypoints.size(1);
  check(k == config_.keypoints, "GeometryNetwork: as many keypoints as configured");
  const Tensor unit = keypoints / (2 * config_.reader_radius);
  const Tensor scaled = unit * config_.position_scale;
  Tensor x = (p.embed->weight.t() + p.embed->bias).unsqueeze(0).expand({b, k, config_.local_features});
  for (std::size_t i = 0; i < p.attention.size(); ++i) {
    x = p.attention[i]->forward(scaled, x, evaluation);
    if (i > 0) x = p.perceptrons[i - 1]->forward(x);
  }
  Pose3d pose;
  pose.code = std::get<0>(p.code_second(torch::relu(p.code_first(x))).max(1));
  pose.keypoints =
      p.keypoint_third(torch::relu(p.keypoint_second(torch::relu(p.keypoint_first(pose.code))))).view({b, k, 3});
  pose.features = p.decoder->forward(pose.code, positions_of(pose, config_), evaluation);
  return pose;
}

ViewFeatures GeometryNetworkImpl::view(const Pose3d& pose, const CameraBatch& camera) {
  return parts_->renderer->view(pose.code, positions_of(pose, config_), pose.features, camera, evaluation);
}

Tensor GeometryNetworkImpl::attend(const ViewFeatures& view, const Tensor& points) {
  return parts_->renderer->attend(view, points, evaluation);
}

Tensor GeometryNetworkImpl::silhouette(const Tensor& features) {
  return parts_->silhouette->forward(features, evaluation).squeeze(-1);
}

Tensor GeometryNetworkImpl::depth(const Tensor& features) {
  return parts_->depth->forward(features, evaluation).squeeze(-1);
}

Tensor GeometryNetworkImpl::nnopcs(const Tensor& features) {
  check(config_.nnopcs, "GeometryNetwork: has an NNOPCS head");
  return parts_->nnopcs->forward(features, evaluation);
}

std::vector<std::vector<Tensor>> GeometryNetworkImpl::clip_groups() {
  const Parts& p = *parts_;
  std::vector<std::shared_ptr<nn::Module>> encoder{p.embed.ptr(), p.code_first.ptr(), p.code_second.ptr()};
  encoder.insert(encoder.end(), p.attention.begin(), p.attention.end());
  encoder.insert(encoder.end(), p.perceptrons.begin(), p.perceptrons.end());
  std::vector<std::shared_ptr<nn::Module>> renderer{p.renderer, p.silhouette, p.depth};
  if (p.nnopcs) renderer.push_back(p.nnopcs);
  return groups_of({encoder,
                    {p.keypoint_first.ptr(), p.keypoint_second.ptr(), p.keypoint_third.ptr(), p.decoder},
                    renderer});
}

struct TextureNetworkImpl::Parts {
  nn::Conv2d stem{nullptr};
  nn::BatchNorm2d stem_norm{nullptr};
  std::vector<std::shared_ptr<ImageBlock>> blocks;
  nn::Linear code_first{nullptr}, code_second{nullptr};
  std::shared_ptr<FeatureDecoder> decoder;
  std::shared_ptr<ViewAttention> renderer;
  std::shared_ptr<Head> color;
  nn::Linear surface{nullptr};
};

TextureNetworkImpl::TextureNetworkImpl(const ModelConfig& c) : config_(c), parts_(std::make_shared<Parts>()) {
  Parts& p = *parts_;
  const int z = c.global_features;
  int channels = c.image_channels.front();
  p.stem = register_module(
      "encoder_stem", nn::Conv2d(nn::Conv2dOptions(c.nnopcs ? 6 : 3, channels, 3).stride(2).padding(1).bias(false)));
  p.stem_norm = register_module("encoder_stem_norm", nn::BatchNorm2d(channels));
  for (std::size_t stage = 0; stage < c.image_channels.size(); ++stage)
    for (int i = 0; i < c.image_blocks; ++i) {
      const int next = c.image_channels[stage];
      p.blocks.push_back(register_module("encoder_stage" + std::to_string(stage) + "_block" + std::to_string(i),
                                         std::make_shared<ImageBlock>(channels, next, stage > 0 && i == 0 ? 2 : 1)));
      channels = next;
    }
  p.code_first = register_module("encoder_code_first", nn::Linear(channels, 4 * z));
  p.code_second = register_module("encoder_code_second", nn::Linear(4 * z, 2 * z));
  p.decoder = register_module("decoder_features", std::make_shared<FeatureDecoder>(c));
  p.renderer = register_module("renderer", std::make_shared<ViewAttention>(c));
  p.color = register_module("head_color", std::make_shared<Head>(c.local_features, c.head_width, c.head_blocks, 3));
  if (c.surface_octaves > 0) p.surface = register_module("surface", nn::Linear(3 * (1 + 2 * c.surface_octaves), c.local_features));
}

TextureCode TextureNetworkImpl::encode(const Tensor& images) {
  Parts& p = *parts_;
  Tensor x = torch::leaky_relu(p.stem_norm(p.stem(images)), leak);
  for (auto& block : p.blocks) x = block->forward(x);
  x = torch::leaky_relu(p.code_first(x.mean({2, 3})), leak);
  x = p.code_second(x);
  if (config_.code_activation) x = torch::leaky_relu(x, leak);
  const int z = config_.global_features;
  return {x.slice(1, 0, z), x.slice(1, z, 2 * z)};
}

ViewFeatures TextureNetworkImpl::view(const Tensor& code, const Pose3d& pose, const CameraBatch& camera) {
  const Tensor features = parts_->decoder->forward(code, pose.keypoints, evaluation);
  return parts_->renderer->view(code, pose.keypoints, features, camera, evaluation);
}

Tensor TextureNetworkImpl::color(const ViewFeatures& view, const Tensor& points, const Tensor& nnopcs) {
  Tensor features = parts_->renderer->attend(view, points, evaluation);
  if (config_.surface_octaves > 0) {
    check(nnopcs.defined(), "TextureNetwork: colour sees the NNOPCS");
    std::vector<Tensor> code{nnopcs};
    for (int k = 0; k < config_.surface_octaves; ++k) {
      const Tensor phase = nnopcs * (std::numbers::pi * (1 << k));
      code.push_back(torch::sin(phase));
      code.push_back(torch::cos(phase));
    }
    features = features + parts_->surface(torch::cat(code, -1));
  }
  return parts_->color->forward(features, evaluation);
}

std::vector<std::vector<Tensor>> TextureNetworkImpl::clip_groups() {
  const Parts& p = *parts_;
  std::vector<std::shared_ptr<nn::Module>> encoder{p.stem.ptr(), p.stem_norm.ptr(), p.code_first.ptr(), p.code_second.ptr()};
  encoder.insert(encoder.end(), p.blocks.begin(), p.blocks.end());
  std::vector<std::shared_ptr<nn::Module>> renderer{p.renderer, p.color};
  if (!p.surface.is_empty()) renderer.push_back(p.surface.ptr());
  return groups_of({encoder, {p.decoder}, renderer});
}

std::int64_t count_parameters(const nn::Module& module) {
  std::int64_t count = 0;
  for (const Tensor& p : module.parameters()) count += p.numel();
  return count;
}

}  // namespace moomill
