#include "neural/evaluate.h"

#include <fmt/format.h>

#include <chrono>
#include <cmath>

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "generator/dataset/contact_sheet.h"

namespace moomill {

using torch::Tensor;
using torch::indexing::Slice;

const char* name_of(Split split) {
  switch (split) {
    case Split::train:
      return "train";
    case Split::validate:
      return "validate";
    case Split::test:
      return "test";
  }
  return "";
}

std::vector<ViewId> chosen_views(const std::vector<int>& frames, const std::vector<int>& cameras, int every_frame,
                                 int every_camera, int max_views) {
  if (every_frame < 1 || every_camera < 1)
    input_error("every {}-th frame and every {}-th camera cannot be chosen; give steps of 1 or more", every_frame,
                every_camera);
  std::vector<ViewId> all;
  for (std::size_t f = 0; f < frames.size(); f += static_cast<std::size_t>(every_frame))
    for (std::size_t c = 0; c < cameras.size(); c += static_cast<std::size_t>(every_camera))
      all.push_back({frames[f], cameras[c], -1});
  const auto wanted = static_cast<std::size_t>(std::max(0, max_views));
  if (wanted == 0 || all.size() <= wanted) return all;
  std::vector<ViewId> some;
  for (std::size_t i = 0; i < wanted; ++i) {  // drawn: even steps would meet the same cameras again and again
    const std::size_t begin = i * all.size() / wanted, end = (i + 1) * all.size() / wanted;
    some.push_back(all[begin + hash_identity({i, all.size()}) % (end - begin)]);
  }
  return some;
}

void require_fit(const Model& model, const SampleSource& source, const std::string& dataset) {
  const ModelConfig& config = model.config.model;
  if (source.keypoint_count() != config.keypoints)
    input_error("{}: has {} keypoints a frame, the model {}; use a model trained on such keypoints", dataset,
                source.keypoint_count(), config.keypoints);
  if (config.nnopcs && !source.has_nnopcs())
    input_error(
        "{}: has no NNOPCS maps, which the model's figures need; generate it with modality \"nnopcs\", or use a model "
        "trained with nnopcs = false",
        dataset);
}

namespace {

Tensor repeat_color(const Tensor& color, const Tensor& like) {
  return color.view({3, 1, 1}).expand_as(like);
}

// What stands behind the animal: the median colour of the picture outside the silhouette. Exact for the even
// backgrounds that datasets have by default.
Tensor background_color(const Tensor& picture, const Tensor& mask) {
  const Tensor outside = picture.index({Slice(), mask < 0.5});
  if (outside.size(1) == 0) return torch::zeros({3});
  return std::get<0>(outside.median(1));
}

struct Shown {
  ViewId id;
  FullView truth;
  ViewMaps maps;
  std::vector<Tensor> pictures, composites;  // per coat
};

class Evaluator {
 public:
  Evaluator(Model& model, const SampleSource& source, const EvaluateOptions& options)
      : model_(model), source_(source), options_(options) {}

  EvaluationResult run() {
    const auto start = std::chrono::steady_clock::now();
    const std::vector<ViewId>& views = options_.views;
    result_.dataset = source_.describe();
    result_.split = options_.split;
    if (options_.color) {
      result_.coats = source_.coats();
      result_.coat_names = source_.coat_names();
      result_.per_coat.resize(result_.coats.size());
    }
    const std::size_t pictures =
        std::min<std::size_t>(views.size(), static_cast<std::size_t>(std::max(0, options_.pictures)));
    std::vector<Shown> shown;
    std::vector<int> frames, cameras;
    for (std::size_t i = 0; i < views.size(); ++i) {
      if (options_.stop && options_.stop()) {
        result_.stopped = true;
        break;
      }
      // Views to show are spread evenly, each in the middle of its share.
      const bool show = shown.size() < pictures && i >= (2 * shown.size() + 1) * views.size() / (2 * pictures);
      Shown one;
      evaluate_view(views[i], show ? &one : nullptr);
      if (show) shown.push_back(std::move(one));
      frames.push_back(views[i].frame);
      cameras.push_back(views[i].camera);
      if (options_.progress) options_.progress(static_cast<int>(i + 1), static_cast<int>(views.size()));
    }
    const auto distinct = [](std::vector<int> v) {
      std::sort(v.begin(), v.end());
      return static_cast<int>(std::unique(v.begin(), v.end()) - v.begin());
    };
    result_.views = static_cast<int>(frames.size());
    result_.frames = distinct(frames);
    result_.cameras = distinct(cameras);
    draw(shown);
    result_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return std::move(result_);
  }

 private:
  // Truth, pose and camera of a view, and the model's own maps of it.
  struct Seen {
    FullView truth;
    PosedAnimal animal;
    AnimalView view;
    Tensor own;     // silhouette
    Tensor either;  // own or true silhouette: where the rest is evaluated
    ViewMaps maps;  // on `either`
  };

  Seen see(const ViewId& id) {
    Seen s;
    s.truth = source_.view({id.frame, id.camera, -1});
    s.animal = pose_animal(model_.geometry, s.truth.keypoints, fmt::format("frame {}", id.frame));
    s.view = view_animal(model_.geometry, s.animal, camera_of(s.truth));
    s.own = render_mask(model_.geometry, s.view, s.animal, options_.refine);
    s.either = torch::maximum(s.own, s.truth.mask);
    RefineOptions exact = options_.refine;
    exact.surface_cell = 1;
    s.maps = render_surface(model_.geometry, s.view, s.either, exact);
    return s;
  }

  void evaluate_view(const ViewId& id, Shown* shown) {
    const Seen s = see(id);
    GeometryFigures& g = result_.geometry;
    const Tensor both = s.own * s.truth.mask;
    if (s.maps.nnopcs.defined()) {
      g.nnopcs_squared.add(masked_squared_error(s.maps.nnopcs, s.truth.nnopcs, s.truth.mask));
      g.nnopcs_squared_own.add(masked_squared_error(s.maps.nnopcs, s.truth.nnopcs, both));
    }
    const auto millimetres = [](std::optional<double> metres) {
      return metres ? std::optional(*metres * 1000) : metres;
    };
    g.depth_mm.add(millimetres(masked_absolute_error(s.maps.depth, s.truth.depth, s.truth.mask)));
    g.depth_mm_own.add(millimetres(masked_absolute_error(s.maps.depth, s.truth.depth, both)));
    g.iou.add(mask_iou(s.own, s.truth.mask));
    g.keypoints_mm.add(1000 * keypoint_error(decoded_keypoints(model_.geometry, s.animal), s.truth.keypoints));
    if (options_.color) evaluate_coats(s, shown);
    if (!shown) return;
    shown->id = id;
    shown->truth = s.truth;
    shown->maps = {s.own, s.maps.depth * s.own, s.maps.nnopcs.defined() ? s.maps.nnopcs * s.own : Tensor()};
  }

  // Codes of all coats, from the pictures of this view or of another camera's.
  Tensor codes_of(const Seen& s, const std::vector<Tensor>& pictures) {
    const std::vector<int> cameras = source_.cameras();
    const auto here = std::find(cameras.begin(), cameras.end(), s.truth.id.camera) - cameras.begin();
    const auto count = static_cast<std::ptrdiff_t>(cameras.size());
    const int from = cameras[static_cast<std::size_t>(((here + options_.code_camera_shift) % count + count) % count)];
    if (from == s.truth.id.camera) return encode(s, torch::stack(pictures));
    const Seen other = see({s.truth.id.frame, from, -1});
    std::vector<Tensor> others;
    for (const int coat : result_.coats) others.push_back(source_.view({s.truth.id.frame, from, coat}).color);
    return encode(other, torch::stack(others));
  }

  Tensor encode(const Seen& s, const Tensor& pictures) {
    if (options_.true_codes) return encode_coats(model_, pictures, s.truth.mask, s.truth.nnopcs);
    return encode_coats(model_, pictures, s.own, s.maps.nnopcs);
  }

  void evaluate_coats(const Seen& s, Shown* shown) {
    std::vector<Tensor> pictures;
    for (const int coat : result_.coats)
      pictures.push_back(source_.view({s.truth.id.frame, s.truth.id.camera, coat}).color);
    const Tensor colors =
        render_color(model_, codes_of(s, pictures), s.view, s.animal, s.either, options_.refine);
    const Tensor everywhere = torch::ones_like(s.truth.mask);
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      const Tensor& picture = pictures[i];
      const Tensor color = colors[static_cast<std::int64_t>(i)];
      const Tensor background = background_color(picture, s.truth.mask);
      const Tensor composite = torch::where(s.own.unsqueeze(0) > 0.5, color, repeat_color(background, color));
      const auto add = [&](Mean ColorFigures::*figure, std::optional<double> value) {
        (result_.per_coat[i].*figure).add(value);
        (result_.average.*figure).add(value);
      };
      add(&ColorFigures::psnr, masked_psnr(color, picture, s.truth.mask));
      add(&ColorFigures::psnr_own, masked_psnr(composite, picture, s.truth.mask));
      add(&ColorFigures::psnr_image, masked_psnr(composite, picture, everywhere));
      add(&ColorFigures::psnr_baseline, mean_color_psnr(picture, s.truth.mask));
      add(&ColorFigures::ssim, masked_box_ssim(composite, picture, s.truth.mask));
      if (!shown) continue;
      shown->pictures.push_back(picture);
      shown->composites.push_back(composite);
    }
  }

  void draw(const std::vector<Shown>& shown) {
    if (shown.empty()) return;
    std::vector<Image8> truth, mine;
    std::vector<std::string> truth_labels, labels;
    for (const Shown& s : shown) {
      // Both silhouettes, and a little around them.
      PixelBox box = mask_box(torch::maximum(s.truth.mask, s.maps.mask));
      if (box.empty()) box = {0, 0, s.truth.width, s.truth.height};
      box = {std::max(0, box.x0 - 4), std::max(0, box.y0 - 4), std::min(s.truth.width, box.x1 + 4),
             std::min(s.truth.height, box.y1 + 4)};
      if (s.maps.nnopcs.defined()) {
        truth.push_back(crop(nnopcs_picture(s.truth.nnopcs, s.truth.mask), box));
        mine.push_back(crop(nnopcs_picture(s.maps.nnopcs, s.maps.mask), box));
      } else {
        truth.push_back(crop(picture_of(s.truth.mask), box));
        mine.push_back(crop(picture_of(s.maps.mask), box));
      }
      truth_labels.push_back(fmt::format("truth {}.{}", s.id.frame, s.id.camera));
      labels.push_back("model");
      if (s.pictures.empty()) continue;
      std::vector<Image8> cells;
      std::vector<std::string> cell_labels;
      for (const bool first : {true, false})
        for (std::size_t c = 0; c < s.pictures.size(); ++c) {
          cells.push_back(crop(picture_of(first ? s.pictures[c] : s.composites[c]), box));
          cell_labels.push_back(first ? fmt::format("coat {}", result_.coats[c]) : "model");
        }
      result_.coat_pictures.push_back(
          picture_grid(cells, cell_labels, static_cast<int>(s.pictures.size()),
                       fmt::format("frame {} camera {}: truth, model", s.id.frame, s.id.camera)));
    }
    truth.insert(truth.end(), mine.begin(), mine.end());
    truth_labels.insert(truth_labels.end(), labels.begin(), labels.end());
    result_.geometry_picture = picture_grid(truth, truth_labels, static_cast<int>(mine.size()), "NNOPCS: truth, model");
  }

  Model& model_;
  const SampleSource& source_;
  const EvaluateOptions& options_;
  EvaluationResult result_;
};

}  // namespace

EvaluationResult evaluate(Model& model, const SampleSource& source, const EvaluateOptions& options) {
  require_fit(model, source, source.describe());
  check(!options.views.empty(), "there are views to evaluate");
  if (options.color) {
    require_texture(model);
    if (source.coats().empty())
      input_error("{}: was opened without coats; name the coats whose colours are evaluated", source.describe());
  }
  return Evaluator(model, source, options).run();
}

}  // namespace moomill
