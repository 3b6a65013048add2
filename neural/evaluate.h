#pragma once
// Reconstruction held against a dataset's truth: geometry once per view, colour once per view and coat.
#include <array>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "neural/inference.h"
#include "neural/metrics.h"
#include "neural/report.h"

namespace moomill {

struct EvaluateOptions {
  std::vector<ViewId> views;   // frames and cameras; coats are those of the source
  std::string split = "test";  // what the views are of, for the reports
  bool color = true;           // false: geometry only
  bool true_codes = false;     // texture codes from the true mask and NNOPCS instead of the model's own
  int code_camera_shift =
      0;  // textures from the picture of the so-many-th next camera of the same frame; 0: of the same view
  RefineOptions refine;  // of the mask; NNOPCS, depth and colour are always evaluated pixel by pixel
  int pictures = 0;      // views shown in pictures
  std::function<void(int done, int all)> progress;
  std::function<bool()> stop;  // asked between views; true: leaves off and reports what is done
};

// Errors of NNOPCS and depth are taken at the true silhouette's pixels, as the paper does; `own` at those that the
// model's own silhouette holds as well.
struct GeometryFigures {
  Mean nnopcs_squared, nnopcs_squared_own;
  Mean depth_mm, depth_mm_own;
  Mean iou;
  Mean keypoints_mm;  // decoded against given, mean over keypoints
};

struct ColorFigures {
  Mean psnr;           // dB, at the true silhouette's pixels, as the public code
  Mean psnr_own;       // the same pixels, but the background's colour where the model's own silhouette is off
  Mean psnr_image;     // the whole image: prediction in the own silhouette, the background's colour outside
  Mean psnr_baseline;  // of painting the true silhouette in the picture's own mean colour there
  Mean ssim;           // luma, over the silhouette's box, of the same composite as psnr_image
};

struct EvaluationResult {
  std::string dataset, split;  // as described by the source
  int frames = 0, cameras = 0, views = 0;
  bool stopped = false;
  GeometryFigures geometry;
  std::vector<int> coats;
  std::vector<std::string> coat_names;
  std::vector<ColorFigures> per_coat;  // parallel to coats
  ColorFigures average;                // over all images
  double seconds = 0;
  // Pictures for people, when asked for: NNOPCS truth above reconstruction, and per shown view the coats likewise.
  Image8 geometry_picture;
  std::vector<Image8> coat_pictures;
};

// The model and the dataset must fit (require_fit), and there must be views.
EvaluationResult evaluate(Model& model, const SampleSource& source, const EvaluateOptions& options);

// Every n-th of the frames with every n-th of the cameras; of those max_views, one drawn from each of as many equal
// shares (0: all).
std::vector<ViewId> chosen_views(const std::vector<int>& frames, const std::vector<int>& cameras, int every_frame,
                                 int every_camera, int max_views);
// InputError unless the dataset has the model's keypoints, and NNOPCS where the model has.
void require_fit(const Model& model, const SampleSource& source, const std::string& dataset);
const char* name_of(Split split);

// What was published for NePuMoo (Waldmann et al., 2024), to stand beside ours.
struct Published {
  double nnopcs_squared = 1.6e-4;
  double depth_mm = 17.8, depth_mm_nepu = 22.3;
  double psnr = 19.35;
  std::array<double, 12> psnr_per_coat{17.39, 20.90, 20.73, 21.04, 18.98, 17.42,
                                       18.64, 16.51, 17.44, 20.38, 20.86, 21.91};
};

std::vector<Measure> measures_of(const EvaluationResult& result);
nlohmann::json to_json(const EvaluationResult& result);
std::string markdown(const EvaluationResult& result, const Model& model);
// results.json, summary.json, table.md and the pictures, into a folder that is made.
void write_evaluation(const EvaluationResult& result, const Model& model, const std::filesystem::path& folder);

}  // namespace moomill
