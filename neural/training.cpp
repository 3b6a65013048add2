#include "neural/training.h"

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "generator/dataset/codecs.h"
#include "neural/training_loop.h"

namespace moomill {
namespace {

using torch::Tensor;
namespace F = torch::nn::functional;

constexpr double tiny = 1e-12;  // under square roots, whose slope is infinite at 0

// Validation draws the same batches every time.
SampleOptions for_validation(SampleOptions samples, int views_per_frame) {
  samples.split = Split::validate;
  samples.keypoint_noise_m = 0;
  samples.turn_cameras = false;
  samples.views_per_frame = views_per_frame;
  return samples;
}

void check_source(const SampleSource& source, const ModelConfig& model, const char* what) {
  if (source.keypoint_count() != model.keypoints)
    input_error("{}: the dataset has {} keypoints, the {} {}; set [model] keypoints = {}", source.describe(), source.keypoint_count(),
                what, model.keypoints, source.keypoint_count());
  if (model.nnopcs && !source.has_nnopcs())
    input_error("{}: the dataset has no NNOPCS; make it with that modality, or set [model] nnopcs = false", source.describe());
}

CameraBatch camera_of(const Batch& batch) {
  return {batch.world_to_camera, batch.keypoints_2d};
}

constexpr Tensor Batch::*batch_fields[] = {
    &Batch::keypoints,         &Batch::noisy_keypoints, &Batch::keypoints_2d,   &Batch::world_to_camera, &Batch::near_depth,
    &Batch::depth_range,       &Batch::silhouette_points, &Batch::silhouette,   &Batch::surface_points,  &Batch::depth,
    &Batch::nnopcs,            &Batch::color,           &Batch::images};

Batch rows_of(const Batch& b, std::int64_t from, std::int64_t to) {
  Batch part;
  part.views.assign(b.views.begin() + from, b.views.begin() + to);
  for (Tensor Batch::*field : batch_fields)
    if ((b.*field).defined()) part.*field = (b.*field).slice(0, from, to);
  return part;
}

Batch on(Batch b, torch::Device device) {
  for (Tensor Batch::*field : batch_fields)
    if ((b.*field).defined()) b.*field = (b.*field).to(device);
  return b;
}

// What both stages are told alike. `training` is the stage's part of the configuration.
template <class Training>
Stage make_stage(const std::string& name, torch::nn::Module& module, std::vector<std::vector<Tensor>> groups,
                 const Training& training, bool nnopcs) {
  Stage stage;
  stage.name = name;
  stage.module = &module;
  stage.groups = std::move(groups);
  stage.optimiser = training.optimiser;
  stage.epochs = training.epochs, stage.validate_every = training.validate_every;
  SampleOptions& s = stage.samples;
  s.batch = training.batch, s.views_per_frame = training.views_per_frame, s.surface_points = training.surface_points;
  s.keypoint_noise_m = training.keypoint_noise_m, s.turn_cameras = training.turn_cameras;
  s.nnopcs = nnopcs;
  return stage;
}

// Means over validation batches, weighted by their views.
class Mean {
 public:
  void add(std::size_t i, double value, double weight) {
    if (sums_.size() <= i) sums_.resize(i + 1, 0.0), weights_.resize(i + 1, 0.0);
    sums_[i] += value * weight, weights_[i] += weight;
  }
  double of(std::size_t i) const { return i < sums_.size() && weights_[i] > 0 ? sums_[i] / weights_[i] : NAN; }

 private:
  std::vector<double> sums_, weights_;
};

}  // namespace

Tensor GeometryLosses::total() const {
  const Tensor sum = silhouette + keypoints + depth + code;
  return nnopcs.defined() ? sum + nnopcs : sum;
}

GeometryPrediction predict(GeometryNetwork& network, const Batch& batch) {
  GeometryPrediction p;
  p.pose = network->encode(batch.noisy_keypoints);
  const ViewFeatures view = network->view(p.pose, camera_of(batch));
  const auto outline = batch.silhouette_points.size(1);
  const Tensor features = network->attend(view, torch::cat({batch.silhouette_points, batch.surface_points}, 1));
  p.silhouette = network->silhouette(features.slice(1, 0, outline));
  const Tensor surface = features.slice(1, outline);
  p.depth = network->depth(surface);
  if (network->config().nnopcs) p.nnopcs = network->nnopcs(surface);
  return p;
}

GeometryLosses geometry_losses(const GeometryPrediction& p, const Batch& batch, const NetepuConfig& config) {
  const GeometryTraining& w = config.geometry;
  GeometryLosses l;
  l.silhouette = w.silhouette_weight * torch::binary_cross_entropy_with_logits(p.silhouette, batch.silhouette);
  const Tensor offset = p.pose.keypoints - batch.keypoints / (2 * config.model.reader_radius);
  l.keypoints = w.keypoint_weight * (offset.square().sum(2) + tiny).sqrt().mean();
  const Tensor depth_error = p.depth - batch.depth;
  l.depth = w.depth_weight *
            (w.squared_depth ? depth_error.square().mean() : (depth_error.square().sum(1) + tiny).sqrt().mean());
  l.code = w.code_weight * (p.pose.code.square().sum(1) + tiny).sqrt().mean();
  if (p.nnopcs.defined()) l.nnopcs = w.nnopcs_weight * (p.nnopcs - batch.nnopcs).square().mean();
  return l;
}

FrozenGeometry freeze(GeometryNetwork& geometry, const Batch& batch) {
  torch::NoGradGuard fixed;
  FrozenGeometry f;
  f.pose = geometry->encode(batch.noisy_keypoints);
  if (geometry->config().surface_octaves > 0) {
    const ViewFeatures view = geometry->view(f.pose, camera_of(batch));
    f.nnopcs = geometry->nnopcs(geometry->attend(view, batch.surface_points));
  }
  return f;
}

Tensor agreement_loss(const Tensor& codes, const std::vector<int>& coats) {
  constexpr double temperature = 0.1;
  const auto b = codes.size(0);
  const Tensor coat = torch::tensor(coats, torch::kLong).to(codes.device());
  const Tensor self = torch::eye(b, codes.options().dtype(torch::kBool));
  const Tensor partner = (coat.unsqueeze(0) == coat.unsqueeze(1)) & ~self;
  const Tensor partners = partner.sum(1), has_partner = partners > 0;
  const Tensor direction = codes / (codes.square().sum(1, true) + tiny).sqrt();
  const Tensor likeness = (torch::mm(direction, direction.t()) / temperature).masked_fill(self, -1e9);
  const Tensor log_share = torch::log_softmax(likeness, 1).masked_fill(~partner, 0).sum(1) / partners.clamp_min(1);
  return -log_share.masked_fill(~has_partner, 0).sum() / has_partner.sum().clamp_min(1);
}

TextureLosses texture_losses(GeometryNetwork& geometry, TextureNetwork& texture, const Batch& batch, const TextureTraining& w,
                             const Tensor& noise) {
  const FrozenGeometry frozen = freeze(geometry, batch);
  const TextureCode code = texture->encode(batch.images);
  const Tensor logvar = code.logvar.clamp(least_logvar, greatest_logvar);
  const Tensor drawn = noise.defined() ? code.mean + noise * (logvar / 2).exp() : code.mean;
  const ViewFeatures view = texture->view(drawn, frozen.pose, camera_of(batch));
  TextureLosses l;
  l.color = w.color_weight * (texture->color(view, batch.surface_points, frozen.nnopcs) - batch.color).square().mean();
  l.divergence = w.divergence_weight * (-0.5 * (1 + logvar - code.mean.square() - logvar.exp()).sum());
  if (w.agreement_weight > 0) {
    std::vector<int> coats;
    for (const ViewId& view_id : batch.views) coats.push_back(view_id.coat);
    l.agreement = w.agreement_weight * agreement_loss(code.mean, coats);
  }
  return l;
}

TrainingEnd train_geometry(const SampleSource& source, const NetepuConfig& config, const std::filesystem::path& out,
                           const TrainingControl& control) {
  const GeometryTraining& g = config.geometry;
  check_source(source, config.model, "model");
  torch::manual_seed(config.seed);
  Model model;
  model.config = config;
  model.geometry = GeometryNetwork(config.model);
  model.geometry->evaluation = control.evaluation;
  model.geometry->to(control.device);
  Stage stage = make_stage("geometry", *model.geometry, model.geometry->clip_groups(), g, config.model.nnopcs);
  stage.samples.seed = config.seed;
  stage.samples.silhouette_points = g.silhouette_points;
  stage.samples.near_sigma = g.near_sigma, stage.samples.far_sigma = g.far_sigma;
  stage.accumulate = [&](const Batch& drawn, std::int64_t) {
    const Batch batch = on(drawn, control.device);
    const GeometryLosses l = geometry_losses(predict(model.geometry, batch), batch, config);
    l.total().backward();
    Scalars terms{{"silhouette", l.silhouette.item<double>()},
                  {"keypoints", l.keypoints.item<double>()},
                  {"depth", l.depth.item<double>()},
                  {"code", l.code.item<double>()}};
    if (l.nnopcs.defined()) terms.emplace_back("nnopcs", l.nnopcs.item<double>());
    return terms;
  };
  const SampleOptions validation = for_validation(stage.samples, 4);
  stage.validation = validation;
  stage.validate = [&]() -> Scalars {
    Mean mean;
    for (int i = 0; i < source.batches_per_epoch(validation); ++i) {
      const Batch b = on(source.batch(validation, 0, i), control.device);
      const auto n = static_cast<double>(b.views.size());
      const GeometryPrediction p = predict(model.geometry, b);
      mean.add(0, geometry_losses(p, b, config).total().item<double>(), n);
      // In the range of the given keypoints, as the targets are.
      const Tensor depth_error = (p.depth - b.depth) * b.depth_range.unsqueeze(1);
      mean.add(1, 1e3 * depth_error.abs().mean().item<double>(), n);
      mean.add(2, ((p.silhouette > 0) != (b.silhouette > 0.5)).to(torch::kFloat).mean().item<double>(), n);
      const Tensor offset = p.pose.keypoints * (2 * config.model.reader_radius) - b.keypoints;
      mean.add(3, 1e3 * offset.square().sum(2).sqrt().mean().item<double>(), n);
      if (p.nnopcs.defined()) mean.add(4, (p.nnopcs - b.nnopcs).square().mean().item<double>(), n);
    }
    Scalars figures{{"loss", mean.of(0)},
                    {"depth MAE (mm)", mean.of(1)},
                    {"wrong silhouette points", mean.of(2)},
                    {"keypoint error (mm)", mean.of(3)}};
    if (config.model.nnopcs) figures.emplace_back("NNOPCS MSE", mean.of(4));
    return figures;
  };
  stage.save_best = [&](const std::filesystem::path& file, const nlohmann::json& provenance) {
    model.provenance = {{"geometry", provenance}};
    save_model(file, model, false);
  };
  return run_training(source, config, stage, out, control);
}

TrainingEnd train_texture(const SampleSource& source, const NetepuConfig& config, const std::filesystem::path& geometry_model,
                          const std::filesystem::path& out, const TrainingControl& control) {
  const TextureTraining& t = config.texture;
  Model model = load_model(geometry_model);
  if (!(model.config.model == config.model))
    input_error("{}: its [model] is not that of the configuration; train the geometry with this configuration, or use the one it was "
                "trained with",
                geometry_model.string());
  check_source(source, config.model, "geometry model");
  torch::manual_seed(config.seed + 1);
  model.config.texture = t;
  model.coat_names = source.coat_names();
  model.texture = TextureNetwork(config.model);
  model.geometry->evaluation = model.texture->evaluation = control.evaluation;
  model.geometry->to(control.device);
  model.texture->to(control.device);
  model.geometry->eval();
  Stage stage = make_stage("texture", *model.texture, model.texture->clip_groups(), t, config.model.nnopcs);
  const std::vector<std::uint8_t> base = read_file(geometry_model);
  stage.base = xxh64_hex(base.data(), base.size());
  stage.samples.seed = hash_identity({config.seed, hash_text("texture")});
  stage.samples.color = true;
  stage.samples.encoder = t.encoder;
  stage.accumulate = [&](const Batch& batch, std::int64_t step) {
    const auto b = static_cast<std::int64_t>(batch.views.size());
    const std::int64_t part = t.micro_batch > 0 ? t.micro_batch : b;
    double color = 0, divergence = 0, agreement = 0;
    for (std::int64_t from = 0; from < b; from += part) {
      const std::int64_t to = std::min(b, from + part);
      const Batch rows = on(rows_of(batch, from, to), control.device);
      const Tensor noise = keyed_normal(hash_identity({config.seed, hash_text("code noise"), static_cast<std::uint64_t>(step),
                                                       static_cast<std::uint64_t>(from)}),
                                        {to - from, config.model.global_features})
                               .to(control.device);
      const TextureLosses l = texture_losses(model.geometry, model.texture, rows, t, noise);
      const double share = static_cast<double>(to - from) / static_cast<double>(b);  // but for divergence, terms are means over views
      const Tensor means = l.agreement.defined() ? l.color + l.agreement : l.color;
      (means * share + l.divergence).backward();
      color += share * l.color.item<double>(), divergence += l.divergence.item<double>();
      if (l.agreement.defined()) agreement += share * l.agreement.item<double>();
    }
    Scalars terms{{"color", color}, {"divergence", divergence}};
    if (t.agreement_weight > 0) terms.emplace_back("agreement", agreement);
    return terms;
  };
  const SampleOptions validation = for_validation(stage.samples, 4);
  stage.validation = validation;
  stage.validate = [&]() -> Scalars {
    Mean mean;
    for (int i = 0; i < source.batches_per_epoch(validation); ++i) {
      const Batch b = on(source.batch(validation, 0, i), control.device);
      const auto n = static_cast<double>(b.views.size());
      const TextureCode code = model.texture->encode(b.images);
      const FrozenGeometry frozen = freeze(model.geometry, b);
      const ViewFeatures view = model.texture->view(code.mean, frozen.pose, camera_of(b));
      const Tensor error = (model.texture->color(view, b.surface_points, frozen.nnopcs).clamp(0, 1) - b.color).square().mean({1, 2});
      mean.add(0, error.mean().item<double>(), n);
      mean.add(1, (-10 * (error + 1e-10).log10()).mean().item<double>(), n);
      const Tensor flat = (b.color - b.color.mean(1, true)).square().mean({1, 2});
      mean.add(2, (-10 * (flat + 1e-10).log10()).mean().item<double>(), n);
    }
    return {{"color MSE", mean.of(0)}, {"PSNR in the mask (dB)", mean.of(1)}, {"PSNR above the mean colour (dB)", mean.of(1) - mean.of(2)}};
  };
  stage.save_best = [&](const std::filesystem::path& file, const nlohmann::json& provenance) {
    model.provenance["texture"] = provenance;
    save_model(file, model, false);
  };
  return run_training(source, config, stage, out, control);
}

}  // namespace moomill
