#include "neural/speed.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "neural/pose_file.h"

namespace moomill {

using torch::Tensor;

namespace {

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0 : values[values.size() / 2];
}

// A dataset's view at the measured size.
struct TimedView {
  FullView truth;  // at the dataset's size
  CameraRecord camera;
  Tensor picture;  // [3, h, w] at the measured size
};

Tensor enlarged(const Tensor& image, int width, int height) {
  namespace F = torch::nn::functional;
  if (image.size(1) == height && image.size(2) == width) return image;
  return F::interpolate(image.unsqueeze(0), F::InterpolateFuncOptions()
                                                .size(std::vector<std::int64_t>{height, width})
                                                .mode(torch::kBilinear)
                                                .align_corners(false))[0];
}

// Bilinear samples of a map [C, h, w] at points [M, 2] in image units: [M, C].
Tensor sample(const Tensor& map, const Tensor& points) {
  namespace F = torch::nn::functional;
  const Tensor grid = (points * 2 - 1).view({1, 1, points.size(0), 2});
  return F::grid_sample(map.unsqueeze(0), grid,
                        F::GridSampleFuncOptions().padding_mode(torch::kBorder).align_corners(false))[0]
      .squeeze(1)
      .t();
}

// As render_maps(), with the network's answers thrown away for the dataset's.
ViewMaps stand_in_maps(GeometryNetwork& geometry, const AnimalView& view, const PosedAnimal& animal,
                       const FullView& truth, const RefineOptions& options, std::int64_t* points) {
  const PointFunction logits = [&](const Tensor& p) {
    geometry->silhouette(geometry->attend(view.features, p.unsqueeze(0)));
    return (sample(truth.mask.unsqueeze(0), p).flatten() - 0.5) * 10;
  };
  ViewMaps maps;
  maps.mask = trace_mask(logits, view.camera.width, view.camera.height, search_box(view, animal), {}, options, points);
  if (!geometry->config().nnopcs) return maps;
  const PointFunction surface = [&](const Tensor& p) {
    surface_at(geometry, view, p, Surface::nnopcs);
    return sample(truth.nnopcs, p);
  };
  maps.nnopcs = fill_mask(surface, 3, maps.mask, options, points);
  return maps;
}

}  // namespace

SpeedResult measure_speed(Model& model, const SampleSource& source, const SpeedOptions& options) {
  require_texture(model);
  if (source.coats().empty()) input_error("{}: was opened without coats; name one to encode", source.describe());
  const Inference guard;
  std::vector<int> frames;
  for (const Split split : {Split::test, Split::validate, Split::train})
    if (frames.empty()) frames = source.frames(split);
  const std::vector<int> cameras = source.cameras();
  if (frames.empty() || cameras.empty()) input_error("{}: has no views to measure on", source.describe());
  std::vector<TimedView> views;
  const auto count = static_cast<std::size_t>(std::max(1, options.views));
  for (std::size_t i = 0; i < count; ++i) {
    const int frame = frames[i * frames.size() / count], camera = cameras[(i * 5 + 1) % cameras.size()];
    TimedView v;
    v.truth = source.view({frame, camera, source.coats()[0]});
    v.camera = resized(camera_of(v.truth), options.width, options.height);
    v.picture = enlarged(v.truth.color, options.width, options.height);
    views.push_back(std::move(v));
  }

  SpeedResult result;
  result.dataset = source.describe();
  result.width = options.width;
  result.height = options.height;
  result.threads = at::get_num_threads();
  result.views = static_cast<int>(views.size());
  result.untrained = options.untrained;
  result.variants = {{"every pixel", Precision::float32, 1, 1},
                     {"coarse to fine", Precision::float32, 0, 1},
                     {"coarse to fine, interpolated", Precision::float32, 0, options.surface_cell}};
  if (has_bfloat16()) {
    result.variants.push_back({"coarse to fine, bfloat16", Precision::bfloat16, 0, 1});
    result.variants.push_back({"coarse to fine, interpolated, bfloat16", Precision::bfloat16, 0, options.surface_cell});
  }
  const Evaluation before = model.geometry->evaluation;
  std::vector<ViewMaps> full(views.size());
  for (SpeedVariant& variant : result.variants) {
    model.geometry->evaluation.precision = variant.precision;
    RefineOptions refine;
    refine.mask_cell = variant.mask_cell;
    refine.surface_cell = variant.surface_cell;
    const bool reference = &variant == &result.variants.front();
    std::vector<double> seconds, geometry_seconds;
    for (std::size_t i = 0; i < views.size(); ++i) {
      const TimedView& v = views[i];
      for (int repeat = 0; repeat < (reference ? 1 : options.repeats); ++repeat) {
        std::int64_t points = 0;
        const auto start = std::chrono::steady_clock::now();
        const PosedAnimal animal = pose_animal(model.geometry, v.truth.keypoints, source.describe());
        const AnimalView view = view_animal(model.geometry, animal, v.camera);
        const ViewMaps maps = options.untrained
                                  ? stand_in_maps(model.geometry, view, animal, v.truth, refine, &points)
                                  : render_maps(model.geometry, view, animal, refine, Surface::nnopcs, &points);
        const auto middle = std::chrono::steady_clock::now();
        encode_coats(model, v.picture.unsqueeze(0), maps.mask, maps.nnopcs);
        const auto end = std::chrono::steady_clock::now();
        geometry_seconds.push_back(std::chrono::duration<double>(middle - start).count());
        seconds.push_back(std::chrono::duration<double>(end - start).count());
        if (repeat > 0) continue;
        variant.points += static_cast<double>(points) / static_cast<double>(views.size());
        if (reference) full[i] = maps;
        const MapDifference d = compare_maps(full[i], maps);
        const auto share = static_cast<double>(views.size());
        variant.difference.mask_share += d.mask_share / share;
        variant.difference.nnopcs_mean += d.nnopcs_mean / share;
        variant.difference.nnopcs_max = std::max(variant.difference.nnopcs_max, d.nnopcs_max);
      }
    }
    variant.seconds = median(seconds);
    variant.geometry_seconds = median(geometry_seconds);
  }
  model.geometry->evaluation = before;
  return result;
}

std::vector<Measure> measures_of(const SpeedResult& r) {
  std::vector<Measure> out;
  for (const SpeedVariant& v : r.variants) {
    out.push_back({v.name + ": re-identification", 1 / v.seconds, "frames/s", {}, {}});
    if (r.untrained || &v == &r.variants.front()) continue;
    out.push_back({v.name + ": mean change of NNOPCS", v.difference.nnopcs_mean, "", 1e-3, {}});
    out.push_back({v.name + ": silhouette pixels that differ", v.difference.mask_share, "", {}, {}});
  }
  return out;
}

nlohmann::json to_json(const SpeedResult& r) {
  nlohmann::json variants = nlohmann::json::array();
  for (const SpeedVariant& v : r.variants) {
    nlohmann::json j{{"name", v.name},
                     {"frames_per_second", number_json(1 / v.seconds)},
                     {"seconds", v.seconds},
                     {"geometry_seconds", v.geometry_seconds},
                     {"points_evaluated", v.points}};
    if (!r.untrained) {
      j["silhouette_pixels_that_differ"] = v.difference.mask_share;
      j["nnopcs_mean_change"] = v.difference.nnopcs_mean;
      j["nnopcs_largest_change"] = v.difference.nnopcs_max;
    }
    variants.push_back(std::move(j));
  }
  return {{"model", r.model},     {"dataset", r.dataset}, {"width", r.width},         {"height", r.height},
          {"threads", r.threads}, {"views", r.views},     {"untrained", r.untrained}, {"variants", variants}};
}

std::string markdown(const SpeedResult& r) {
  std::string out = fmt::format(
      "# Re-identification speed\n\n{}, {} views rendered at {} x {}, {} threads: pose, silhouette and NNOPCS, "
      "encoding; one view at "
      "a time, median. The paper has 0.5 frames/s at this size on a Titan RTX.\n\n"
      "| variant | frames/s | of a view for geometry, s | points | silhouette differs | NNOPCS mean change | largest "
      "|\n|---|---|---|---|---|---|---|\n",
      r.model, r.views, r.width, r.height, r.threads);
  for (const SpeedVariant& v : r.variants) {
    out += fmt::format("| {} | {:.2f} | {:.3f} | {:.0f} |", v.name, 1 / v.seconds, v.geometry_seconds, v.points);
    if (r.untrained || &v == &r.variants.front())
      out += " | | |\n";
    else
      out += fmt::format(" {:.3f} % | {:.1e} | {:.1e} |\n", 100 * v.difference.mask_share, v.difference.nnopcs_mean,
                         v.difference.nnopcs_max);
  }
  if (r.untrained)
    out +=
        "\nUntrained weights: the network is asked at the points that the dataset's own silhouette and surface call "
        "for.\n";
  return out;
}

void write_speed(const SpeedResult& result, const std::filesystem::path& folder) {
  write_file_atomically(folder / "speed.json", dump_json(to_json(result)));
  write_file_atomically(folder / "summary.json", summary_json("Re-identification speed", measures_of(result)));
  write_file_atomically(folder / "table.md", markdown(result));
}

}  // namespace moomill
