#pragma once
// Training and test samples of a dataset, as tensors. A batch is a pure function of (dataset, options, epoch, number of the
// batch): any order, any number of threads, after any resumption.
#include <torch/torch.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "neural/config.h"

namespace moomill {

enum class Split { train, validate, test };

struct ViewId {
  int frame = 0, camera = 0, coat = -1;  // as numbered in the dataset
  bool operator==(const ViewId&) const = default;
};

// One view as a whole, for evaluation and for the texture encoder. Tensors are CPU float.
struct FullView {
  ViewId id;
  int width = 0, height = 0;
  torch::Tensor keypoints;        // [K, 3] world metres
  torch::Tensor keypoints_2d;     // [K, 2] image units (share of width and height)
  torch::Tensor world_to_camera;  // [3, 4]
  torch::Tensor intrinsics;       // [3, 3] pixels
  torch::Tensor mask;             // [h, w] 0 or 1
  torch::Tensor depth;            // [h, w] metres, camera z; 0 outside
  torch::Tensor nnopcs;           // [3, h, w] in [0, 1]; 0 outside; undefined where the dataset has none
  torch::Tensor color;            // [3, h, w] sRGB in [0, 1], background and all; undefined where coat < 0
};

struct SampleOptions {
  Split split = Split::train;
  std::uint64_t seed = 1;
  int batch = 64;
  int views_per_frame = 1;        // cameras drawn per frame and epoch
  int silhouette_points = 0;      // half with near_sigma, half with far_sigma about boundary pixels
  int surface_points = 500;       // uniform over the mask
  double near_sigma = 0.0125, far_sigma = 0.125;  // image units
  double keypoint_noise_m = 0;
  bool turn_cameras = false;      // ring shift by k x 45 degrees, keypoints turned alike; InputError without such rings
  bool color = false;             // draw a coat, and give color and encoder images
  bool nnopcs = true;             // InputError when the dataset has none
  EncoderInput encoder;           // of `images`
};

struct Batch {
  std::vector<ViewId> views;        // B: whose pictures these are (before turning)
  torch::Tensor keypoints;          // [B, K, 3] world metres, turned, without noise
  torch::Tensor noisy_keypoints;    // the same with noise
  torch::Tensor keypoints_2d;       // [B, K, 2] projections of keypoints, image units
  torch::Tensor world_to_camera;    // [B, 3, 4] of the camera that sees the turned keypoints
  torch::Tensor near_depth, depth_range;  // [B] metres: camera z of the nearest keypoint, farthest minus nearest (at least 1e-3)
  torch::Tensor silhouette_points, silhouette;  // [B, S, 2], [B, S] (0 or 1, float)
  torch::Tensor surface_points;     // [B, P, 2] image units, pixel centres
  torch::Tensor depth;              // [B, P], (z - near_depth) / depth_range
  torch::Tensor nnopcs;             // [B, P, 3]
  torch::Tensor color;              // [B, P, 3] sRGB in [0, 1]
  torch::Tensor images;             // [B, 6 or 3, h, w] masked sRGB, then masked NNOPCS
};

// A dataset behind its packed cache: one memory-mapped file for geometry and one per coat, foreground pixels only, made at
// the first opening (in parallel, atomically) and made anew when the manifest or the records changed.
class SampleSource {
 public:
  // cache: where the packed files lie; empty: <dataset>/../<name>.cache. With the nepumoo layout but no manifest (a dataset from
  // elsewhere) keypoints.csv, parameters.cfg and the folder names say what there is. InputError in one sentence.
  // coats: which are needed (packed and checked); geometry alone needs none. progress: told what is being packed, and how far.
  SampleSource(const std::filesystem::path& dataset, const std::vector<int>& coats, const std::filesystem::path& cache = {},
               const std::function<void(const std::string& what, std::size_t done, std::size_t of)>& progress = {});
  ~SampleSource();
  int keypoint_count() const;
  int width() const;
  int height() const;
  bool has_nnopcs() const;
  double reader_radius() const;   // metres, of the manifest (1.5 without)
  const std::vector<int>& coats() const;
  std::vector<std::string> coat_names() const;  // parallel to coats()
  std::vector<int> available_coats() const;     // all that the dataset has pictures of
  std::vector<int> frames(Split split) const;   // empty where a split has none; frames that no camera sees are left out
  std::vector<int> cameras() const;
  std::string describe() const;  // one line: poses, cameras, coats, resolution, split sizes
  FullView view(const ViewId& id) const;
  // The texture encoder's input of a view, masked: [6, h, w], or [3, h, w] where view.nnopcs is undefined.
  torch::Tensor encoder_image(const FullView& view, const EncoderInput& encoder) const;

  // The last, short batch of an epoch is dropped while training, unless it is the only one. InputError when the split is empty.
  int batches_per_epoch(const SampleOptions& options) const;
  Batch batch(const SampleOptions& options, int epoch, int index) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Draws batches ahead on a thread of its own, in order from (epoch, index).
class Prefetcher {
 public:
  Prefetcher(const SampleSource& source, SampleOptions options, int epoch, int index, int ahead = 4);
  ~Prefetcher();
  Batch next();  // exceptions of the drawing thread are thrown here

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Pictures to encoder input outside a dataset (a photo with mask): masks, crops, resizes by area, stacks. color [3, h, w],
// mask [h, w], nnopcs [3, h, w] or undefined.
torch::Tensor make_encoder_image(const torch::Tensor& color, const torch::Tensor& mask, const torch::Tensor& nnopcs,
                                 const EncoderInput& encoder);

}  // namespace moomill
