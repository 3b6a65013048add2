#include "neural/inference.h"

#include <cmath>

#include "generator/core/error.h"

namespace moomill {

using torch::Tensor;
using torch::indexing::Slice;

PosedAnimal pose_animal(GeometryNetwork& geometry, const Tensor& keypoints, const std::string& what) {
  const int expected = geometry->config().keypoints;
  if (keypoints.dim() != 2 || keypoints.size(1) != 3 || keypoints.size(0) != expected)
    input_error("{}: has {} keypoints, the model {}; use a model trained on such keypoints", what, keypoints.size(0),
                expected);
  if (!torch::isfinite(keypoints).all().item<bool>())
    input_error("{}: a keypoint's coordinate is not a finite number; give every keypoint in world metres", what);
  const Inference guard;
  PosedAnimal animal;
  animal.keypoints = keypoints.to(torch::kFloat).contiguous();
  animal.pose = geometry->encode(animal.keypoints.unsqueeze(0));
  return animal;
}

Tensor decoded_keypoints(const GeometryNetwork& geometry, const PosedAnimal& animal) {
  return animal.pose.keypoints[0] * (2 * geometry->config().reader_radius);
}

CameraRecord camera_of(const FullView& view) {
  CameraRecord camera;
  camera.id = view.id.camera;
  camera.width = view.width;
  camera.height = view.height;
  const Tensor matrix = view.world_to_camera.to(torch::kDouble).contiguous(),
               k = view.intrinsics.to(torch::kDouble).contiguous();
  std::copy_n(matrix.data_ptr<double>(), 12, camera.world_to_camera.begin());
  camera.fx = k[0][0].item<double>();
  camera.fy = k[1][1].item<double>();
  camera.cx = k[0][2].item<double>();
  camera.cy = k[1][2].item<double>();
  return camera;
}

CameraBatch see_keypoints(const Tensor& keypoints, const CameraRecord& camera) {
  const Tensor matrix =
      torch::from_blob(const_cast<double*>(camera.world_to_camera.data()), {3, 4}, torch::kDouble).clone();
  const Tensor in_camera = keypoints.to(torch::kDouble).matmul(matrix.slice(1, 0, 3).t()) + matrix.select(1, 3);
  const Tensor z = in_camera.select(1, 2);
  if (!(z > 1e-6).all().item<bool>())
    input_error("camera {}: keypoint {} does not lie in front of it; turn the camera towards the animal", camera.id,
                z.argmin().item<std::int64_t>());
  const Tensor x = (camera.fx * in_camera.select(1, 0) / z + camera.cx) / camera.width;
  const Tensor y = (camera.fy * in_camera.select(1, 1) / z + camera.cy) / camera.height;
  CameraBatch batch;
  batch.world_to_camera = matrix.to(torch::kFloat).unsqueeze(0);
  batch.keypoints_2d = torch::stack({x, y}, 1).to(torch::kFloat).unsqueeze(0);
  return batch;
}

AnimalView view_animal(GeometryNetwork& geometry, const PosedAnimal& animal, const CameraRecord& camera) {
  if (camera.width <= 0 || camera.height <= 0)
    input_error("camera {}: its picture is {} x {} pixels; give a width and a height of 1 or more", camera.id,
                camera.width, camera.height);
  const Inference guard;
  AnimalView view;
  view.camera = camera;
  view.batch = see_keypoints(animal.keypoints, camera);
  view.features = geometry->view(animal.pose, view.batch);
  const Tensor row = view.batch.world_to_camera[0][2], z = animal.keypoints.matmul(row.slice(0, 0, 3)) + row[3];
  view.near_depth = z.min().item<float>();
  view.depth_range = std::max(z.max().item<float>() - view.near_depth, static_cast<float>(minimum_depth_range));
  return view;
}

PixelBox search_box(const AnimalView& view, const PosedAnimal& animal) {
  const CameraRecord& camera = view.camera;
  const Tensor x = view.batch.keypoints_2d[0].select(1, 0) * camera.width,
               y = view.batch.keypoints_2d[0].select(1, 1) * camera.height;
  // The animal's radius about its keypoints' centre, as large as it gets at the nearest keypoint.
  const Tensor centre = animal.keypoints.mean(0, true);
  const double radius = (animal.keypoints - centre).square().sum(1).sqrt().max().item<double>();
  const double pad = 0.25 * radius * std::max(camera.fx, camera.fy) / view.near_depth + 2;
  PixelBox box;
  const auto low = [&](const Tensor& v, int size) {
    return static_cast<int>(std::clamp(std::floor(v.min().item<double>() - pad), 0.0, static_cast<double>(size)));
  };
  const auto high = [&](const Tensor& v, int size) {
    return static_cast<int>(std::clamp(std::ceil(v.max().item<double>() + pad), 0.0, static_cast<double>(size)));
  };
  box.x0 = low(x, camera.width);
  box.x1 = high(x, camera.width);
  box.y0 = low(y, camera.height);
  box.y1 = high(y, camera.height);
  return box;
}

namespace {

// Pixels of the keypoints that fall into the image.
std::vector<std::int64_t> keypoint_pixels(const AnimalView& view) {
  const CameraRecord& camera = view.camera;
  const Tensor points = view.batch.keypoints_2d[0].contiguous();
  std::vector<std::int64_t> pixels;
  for (std::int64_t k = 0; k < points.size(0); ++k) {
    const double x = points[k][0].item<double>() * camera.width, y = points[k][1].item<double>() * camera.height;
    if (x >= 0 && y >= 0 && x < camera.width && y < camera.height)
      pixels.push_back(static_cast<std::int64_t>(y) * camera.width + static_cast<std::int64_t>(x));
  }
  return pixels;
}

}  // namespace

Tensor render_mask(GeometryNetwork& geometry, const AnimalView& view, const PosedAnimal& animal,
                   const RefineOptions& options, std::int64_t* evaluated) {
  const Inference guard;
  const PointFunction logits = [&](const Tensor& points) {
    return geometry->silhouette(geometry->attend(view.features, points.unsqueeze(0))).flatten();
  };
  return trace_mask(logits, view.camera.width, view.camera.height, search_box(view, animal), keypoint_pixels(view),
                    options, evaluated);
}

Tensor surface_at(GeometryNetwork& geometry, const AnimalView& view, const Tensor& points, Surface surface) {
  const Inference guard;
  const Tensor features = geometry->attend(view.features, points.unsqueeze(0));
  std::vector<Tensor> parts;
  if (surface == Surface::depth_and_nnopcs) parts.push_back(geometry->depth(features)[0].unsqueeze(1));
  if (geometry->config().nnopcs) parts.push_back(geometry->nnopcs(features)[0]);
  check(!parts.empty(), "a surface of something");
  return torch::cat(parts, 1);
}

ViewMaps render_surface(GeometryNetwork& geometry, const AnimalView& view, const Tensor& mask,
                        const RefineOptions& options, Surface surface, std::int64_t* evaluated) {
  const Inference guard;
  ViewMaps maps;
  maps.mask = mask;
  const int depths = surface == Surface::depth_and_nnopcs, channels = depths + (geometry->config().nnopcs ? 3 : 0);
  if (channels == 0) return maps;
  const PointFunction values_at = [&](const Tensor& points) { return surface_at(geometry, view, points, surface); };
  const Tensor values = fill_mask(values_at, channels, mask, options, evaluated);
  if (depths) maps.depth = (values[0] * view.depth_range + view.near_depth) * mask;
  if (geometry->config().nnopcs) maps.nnopcs = values.slice(0, depths, depths + 3).clamp(0, 1);
  return maps;
}

ViewMaps render_maps(GeometryNetwork& geometry, const AnimalView& view, const PosedAnimal& animal,
                     const RefineOptions& options, Surface surface, std::int64_t* evaluated) {
  return render_surface(geometry, view, render_mask(geometry, view, animal, options, evaluated), options, surface,
                        evaluated);
}

Tensor render_color(Model& model, const Tensor& codes, const AnimalView& view, const PosedAnimal& animal,
                    const Tensor& mask, const RefineOptions& options) {
  const Inference guard;
  const std::int64_t coats = codes.size(0);
  // The coats of a view are a batch over one pose and camera.
  const auto repeat = [&](const Tensor& t) {
    std::vector<std::int64_t> sizes(static_cast<std::size_t>(t.dim()), -1);
    sizes[0] = coats;
    return t.expand(sizes).contiguous();
  };
  const Pose3d pose{repeat(animal.pose.code), repeat(animal.pose.keypoints), repeat(animal.pose.features)};
  const CameraBatch camera{repeat(view.batch.world_to_camera), repeat(view.batch.keypoints_2d)};
  const ViewFeatures features = model.texture->view(codes, pose, camera);
  const bool surface_seen = model.config.model.surface_octaves > 0;
  const PointFunction colors = [&](const Tensor& points) {  // [M, 2] to [M, 3 T]
    const Tensor one = points.unsqueeze(0);
    const Tensor nnopcs = surface_seen ? model.geometry->nnopcs(model.geometry->attend(view.features, one)) : Tensor();
    const Tensor c = model.texture->color(features, one.expand({coats, points.size(0), 2}).contiguous(), nnopcs);
    return c.permute({1, 0, 2}).reshape({points.size(0), 3 * coats});
  };
  RefineOptions exact = options;
  exact.surface_cell = 1;  // colours are not smooth
  exact.chunk = std::max<std::int64_t>(1, options.chunk / coats);
  const Tensor values = fill_mask(colors, static_cast<int>(3 * coats), mask, exact);
  return values.clamp(0, 1).view({coats, 3, mask.size(0), mask.size(1)});
}

Tensor encode_coats(Model& model, const Tensor& colors, const Tensor& mask, const Tensor& nnopcs) {
  require_texture(model);
  const Inference guard;
  std::vector<Tensor> images;
  for (const Tensor& color : colors.unbind(0))
    images.push_back(make_encoder_image(color, mask, model.config.model.nnopcs ? nnopcs : Tensor(),
                                        model.config.texture.encoder));
  return model.texture->encode(torch::stack(images)).mean;
}

void require_texture(const Model& model) {
  if (model.texture.is_empty())
    input_error(
        "the model has geometry only, no texture networks; train them (netepu train-texture) and give that checkpoint");
}

MapDifference compare_maps(const ViewMaps& full, const ViewMaps& shortcut) {
  MapDifference d;
  const Tensor a = full.mask > 0.5, b = shortcut.mask > 0.5, both = a & b;
  d.mask_share = (a != b).sum().item<double>() / std::max(1.0, a.sum().item<double>());
  if (!both.any().item<bool>()) return d;
  if (full.nnopcs.defined() && shortcut.nnopcs.defined()) {
    const Tensor difference = (full.nnopcs - shortcut.nnopcs).abs().index({Slice(), both}).to(torch::kDouble);
    d.nnopcs_mean = difference.mean().item<double>();
    d.nnopcs_max = difference.max().item<double>();
  }
  if (!full.depth.defined() || !shortcut.depth.defined()) return d;
  const Tensor difference = (full.depth - shortcut.depth).abs().index({both}).to(torch::kDouble) * 1000;
  d.depth_mean_mm = difference.mean().item<double>();
  d.depth_max_mm = difference.max().item<double>();
  return d;
}

}  // namespace moomill
