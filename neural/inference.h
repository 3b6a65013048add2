#pragma once
// A trained model asked about one pose, one camera, one coat. Everything here runs without gradients and in evaluation
// mode, in chunks of bounded memory; the same bits whatever the number of views asked for. CPU float tensors.
#include <torch/torch.h>

#include "generator/dataset/dataset.h"
#include "neural/checkpoint.h"
#include "neural/refine.h"
#include "neural/samples.h"

namespace moomill {

// Without gradients, for the lifetime of a scope.
using Inference = torch::NoGradGuard;

// A pose, encoded.
struct PosedAnimal {
  torch::Tensor keypoints;  // [K, 3] world metres, as given
  Pose3d pose;              // batch of one
};
// keypoints [K, 3] world metres. InputError where K is not the model's or a coordinate is not finite; `what` names
// their origin.
PosedAnimal pose_animal(GeometryNetwork& geometry, const torch::Tensor& keypoints, const std::string& what);

torch::Tensor decoded_keypoints(const GeometryNetwork& geometry, const PosedAnimal& animal);  // [K, 3] world metres

// The camera of a dataset's view.
CameraRecord camera_of(const FullView& view);
// Keypoints [K, 3] seen by a camera, batch of one. InputError where one is not in front of it.
CameraBatch see_keypoints(const torch::Tensor& keypoints, const CameraRecord& camera);

// An animal before a camera: what all pixels share.
struct AnimalView {
  CameraRecord camera;
  CameraBatch batch;      // of one
  ViewFeatures features;  // of the geometry network
  // Metres: camera z of the nearest given keypoint, farthest minus nearest. Depth is learnt in units of the given
  // keypoints, and they are at hand here, so the decoded ones' errors need not enter.
  float near_depth = 0, depth_range = 0;
};
AnimalView view_animal(GeometryNetwork& geometry, const PosedAnimal& animal, const CameraRecord& camera);

// Where to look for the silhouette: around the keypoints' projections, padded by a quarter of the animal's size.
PixelBox search_box(const AnimalView& view, const PosedAnimal& animal);

// Silhouette, [h, w], 0 or 1.
torch::Tensor render_mask(GeometryNetwork& geometry, const AnimalView& view, const PosedAnimal& animal,
                          const RefineOptions& options, std::int64_t* evaluated = nullptr);

// What of the surface is wanted; a texture code needs no depth. NNOPCS comes only where the model has it.
enum class Surface { depth_and_nnopcs, nnopcs };

// Surface at points [M, 2]: [M, C], depth (in units of the keypoints' range) before NNOPCS.
torch::Tensor surface_at(GeometryNetwork& geometry, const AnimalView& view, const torch::Tensor& points,
                         Surface surface = Surface::depth_and_nnopcs);

struct ViewMaps {
  torch::Tensor mask;    // [h, w], 0 or 1
  torch::Tensor depth;   // [h, w] metres, camera z; 0 outside; undefined where not asked for
  torch::Tensor nnopcs;  // [3, h, w], clamped to [0, 1]; 0 outside; undefined where the model has none
};
// The surface inside a mask. *evaluated gains the points evaluated.
ViewMaps render_surface(GeometryNetwork& geometry, const AnimalView& view, const torch::Tensor& mask,
                        const RefineOptions& options, Surface surface = Surface::depth_and_nnopcs,
                        std::int64_t* evaluated = nullptr);
ViewMaps render_maps(GeometryNetwork& geometry, const AnimalView& view, const PosedAnimal& animal,
                     const RefineOptions& options, Surface surface = Surface::depth_and_nnopcs,
                     std::int64_t* evaluated = nullptr);

// Colours of coats inside a mask: codes [T, z] to sRGB [T, 3, h, w], clamped to [0, 1], 0 outside.
torch::Tensor render_color(Model& model, const torch::Tensor& codes, const AnimalView& view,
                           const PosedAnimal& animal, const torch::Tensor& mask, const RefineOptions& options);

// Codes (means) of pictures of one view: colors [T, 3, h, w] sRGB, mask and NNOPCS of that view, to [T, z]. Resized to
// the size the texture encoder was trained with.
torch::Tensor encode_coats(Model& model, const torch::Tensor& colors, const torch::Tensor& mask,
                           const torch::Tensor& nnopcs);

// InputError where the model has no texture networks.
void require_texture(const Model& model);

// How far a shortcut (coarse to fine, interpolation, bf16) is from the full evaluation of the same view.
struct MapDifference {
  double mask_share = 0;                       // pixels of another side, over the pixels of the full silhouette
  double nnopcs_mean = 0, nnopcs_max = 0;      // absolute, per channel, over pixels in both masks
  double depth_mean_mm = 0, depth_max_mm = 0;  // likewise
};
MapDifference compare_maps(const ViewMaps& full, const ViewMaps& shortcut);

}  // namespace moomill
