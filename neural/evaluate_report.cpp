// Figures of an evaluation as JSON, as a table beside the paper's, and on disk.
#include <fmt/format.h>

#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "neural/evaluate.h"

namespace moomill {

namespace fs = std::filesystem;

namespace {

nlohmann::json to_json(const Mean& mean) {
  return {{"mean", number_json(mean.value())}, {"images", mean.count}, {"without_value", mean.skipped}};
}

nlohmann::json to_json(const ColorFigures& c) {
  return {{"psnr_db", to_json(c.psnr)},
          {"psnr_own_silhouette_db", to_json(c.psnr_own)},
          {"psnr_image_db", to_json(c.psnr_image)},
          {"psnr_mean_color_db", to_json(c.psnr_baseline)},
          {"ssim", to_json(c.ssim)}};
}

}  // namespace

std::vector<Measure> measures_of(const EvaluationResult& r) {
  const GeometryFigures& g = r.geometry;
  std::vector<Measure> out;
  if (g.nnopcs_squared.count > 0) {
    out.push_back({"NNOPCS mean squared error", g.nnopcs_squared.value(), "", 6e-4, {}});
    out.push_back(
        {"NNOPCS mean squared error where the own silhouette agrees", g.nnopcs_squared_own.value(), "", {}, {}});
  }
  out.push_back({"depth mean absolute error", g.depth_mm.value(), "mm", 35, {}});
  out.push_back({"depth mean absolute error where the own silhouette agrees", g.depth_mm_own.value(), "mm", {}, {}});
  out.push_back({"silhouette intersection over union", g.iou.value(), "", {}, {}});
  out.push_back({"keypoint error", g.keypoints_mm.value(), "mm", {}, {}});
  if (r.average.psnr.count > 0) {
    const ColorFigures& c = r.average;
    out.push_back({"PSNR in the true silhouette", c.psnr.value(), "dB", {}, 17});
    out.push_back(
        {"PSNR in the true silhouette above mean colour", c.psnr.value() - c.psnr_baseline.value(), "dB", {}, 4});
    out.push_back({"PSNR with the own silhouette", c.psnr_own.value(), "dB", {}, {}});
    out.push_back({"PSNR over the image", c.psnr_image.value(), "dB", {}, {}});
    out.push_back({"PSNR of the mean colour", c.psnr_baseline.value(), "dB", {}, {}});
    out.push_back({"SSIM in the silhouette's box", c.ssim.value(), "", {}, {}});
    for (std::size_t i = 0; i < r.coats.size(); ++i)
      out.push_back({fmt::format("PSNR of coat {}", r.coats[i]), r.per_coat[i].psnr.value(), "dB", {}, {}});
  }
  out.push_back({"views evaluated", static_cast<double>(r.views), "", {}, {}});
  out.push_back({"images evaluated", static_cast<double>(r.average.psnr.count + r.average.psnr.skipped), "", {}, {}});
  return out;
}

nlohmann::json to_json(const EvaluationResult& r) {
  const GeometryFigures& g = r.geometry;
  nlohmann::json geometry{{"depth_mae_mm", to_json(g.depth_mm)},
                          {"depth_mae_own_silhouette_mm", to_json(g.depth_mm_own)},
                          {"silhouette_iou", to_json(g.iou)},
                          {"keypoint_error_mm", to_json(g.keypoints_mm)}};
  if (g.nnopcs_squared.count + g.nnopcs_squared.skipped > 0) {
    geometry["nnopcs_mse"] = to_json(g.nnopcs_squared);
    geometry["nnopcs_mse_own_silhouette"] = to_json(g.nnopcs_squared_own);
  }
  nlohmann::json json{{"dataset", r.dataset}, {"split", r.split},       {"frames", r.frames},  {"cameras", r.cameras},
                      {"views", r.views},     {"complete", !r.stopped}, {"geometry", geometry}};
  if (!r.coats.empty()) {
    nlohmann::json coats = nlohmann::json::array();
    for (std::size_t i = 0; i < r.coats.size(); ++i) {
      nlohmann::json coat = to_json(r.per_coat[i]);
      coat["coat"] = r.coats[i];
      coat["name"] = r.coat_names[i];
      coats.push_back(std::move(coat));
    }
    json["color"] = {{"average", to_json(r.average)}, {"coats", coats}};
  }
  return json;
}

std::string markdown(const EvaluationResult& r, const Model& model) {
  const Published paper;
  const GeometryFigures& g = r.geometry;
  const ModelConfig& m = model.config.model;
  std::string out = fmt::format("# Reconstruction, {} split\n\n{}\n\n{} frames x {} cameras, {} views", r.split,
                                r.dataset, r.frames, r.cameras, r.views);
  if (!r.coats.empty())
    out += fmt::format(" x {} coats = {} images", r.coats.size(), r.average.psnr.count + r.average.psnr.skipped);
  out += r.stopped ? "; stopped early, the figures are of these alone.\n\n" : ".\n\n";
  out += "| figure | ours | paper (NePuMoo) |\n|---|---|---|\n";
  const auto row = [&](const std::string& name, const std::string& ours, const std::string& theirs) {
    out += fmt::format("| {} | {} | {} |\n", name, ours, theirs);
  };
  if (g.nnopcs_squared.count > 0) {
    row("NNOPCS mean squared error, at true foreground pixels", fmt::format("{:.2e}", g.nnopcs_squared.value()),
        fmt::format("{:.1e}", paper.nnopcs_squared));
    row("the same where our silhouette agrees", fmt::format("{:.2e}", g.nnopcs_squared_own.value()), "");
  }
  row("depth mean absolute error, at true foreground pixels", figure_text(g.depth_mm.value(), 1) + " mm",
      fmt::format("{} mm (NePu {} mm)", paper.depth_mm, paper.depth_mm_nepu));
  row("the same where our silhouette agrees", figure_text(g.depth_mm_own.value(), 1) + " mm", "");
  row("silhouette, intersection over union", figure_text(g.iou.value(), 4), "");
  row("decoded keypoints, mean distance", figure_text(g.keypoints_mm.value(), 1) + " mm", "");
  if (!r.coats.empty()) {
    const ColorFigures& c = r.average;
    row("PSNR in the true silhouette, mean over images", figure_text(c.psnr.value(), 2) + " dB",
        fmt::format("{} dB", paper.psnr));
    row("PSNR of painting it in its own mean colour", figure_text(c.psnr_baseline.value(), 2) + " dB", "");
    row("PSNR there with our own silhouette", figure_text(c.psnr_own.value(), 2) + " dB", "");
    row("PSNR over the whole image", figure_text(c.psnr_image.value(), 2) + " dB", "");
    row("SSIM of the luma in the silhouette's box", figure_text(c.ssim.value(), 4), "");
    out +=
        "\n| coat | PSNR | paper | above mean colour | own silhouette | image | SSIM "
        "|\n|---|---|---|---|---|---|---|\n";
    for (std::size_t i = 0; i < r.coats.size(); ++i) {
      const ColorFigures& p = r.per_coat[i];
      const int coat = r.coats[i];
      const bool known = coat >= 0 && coat < static_cast<int>(paper.psnr_per_coat.size());
      out += fmt::format("| {} {} | {} | {} | {} | {} | {} | {} |\n", coat, r.coat_names[i],
                         figure_text(p.psnr.value(), 2),
                         known ? figure_text(paper.psnr_per_coat[static_cast<std::size_t>(coat)], 2) : "",
                         figure_text(p.psnr.value() - p.psnr_baseline.value(), 2), figure_text(p.psnr_own.value(), 2),
                         figure_text(p.psnr_image.value(), 2), figure_text(p.ssim.value(), 3));
    }
  }
  const int skipped = g.depth_mm.skipped;
  out += fmt::format(
      "\nWhat differs from the paper: the data are our own (another cow model with coats of our own, other poses and "
      "light; see the line at "
      "the top for their number and resolution; NePuMoo has 910 poses at 1024 x 768), and so is the network's size ({} "
      "local and {} "
      "global features, {:.1f} million parameters of geometry{}; the paper's has 256 and 1024, 46.5 and 52.8 million). "
      "Same protocol: "
      "NNOPCS and depth at the true silhouette's pixels, colours there from a texture code of the same view's picture. "
      "Each image "
      "counts alike; PSNR has peak 1 and is capped at {:.0f} dB; NNOPCS and colours are clamped to [0, 1]. Codes come "
      "from the model's "
      "own silhouette and NNOPCS unless said otherwise. {}{}Views without a foreground pixel, left out of the means: {}.\n",
      m.local_features, m.global_features, static_cast<double>(count_parameters(*model.geometry)) / 1e6,
      model.texture.is_empty()
          ? ""
          : fmt::format(", {:.1f} million of texture", static_cast<double>(count_parameters(*model.texture)) / 1e6),
      psnr_cap,
      !model.texture.is_empty() && model.config.texture.encoder.crop
          ? "The texture encoder is shown the animal cropped, the paper's the whole picture. "
          : "",
      !model.texture.is_empty() && model.config.texture.agreement_weight > 0
          ? "Codes were also trained to agree between views of one individual, by the training split's names; the paper trains on "
            "colours alone. "
          : "",
      skipped);
  return out;
}

void write_evaluation(const EvaluationResult& result, const Model& model, const fs::path& folder) {
  write_file_atomically(folder / "results.json", dump_json(to_json(result)));
  write_file_atomically(folder / "summary.json",
                        summary_json("Reconstruction of the " + result.split + " split", measures_of(result)));
  write_file_atomically(folder / "table.md", markdown(result, model));
  if (!result.geometry_picture.empty()) write_png(folder / "nnopcs.png", result.geometry_picture);
  for (std::size_t i = 0; i < result.coat_pictures.size(); ++i)
    write_png(folder / fmt::format("coats{}.png", i + 1), result.coat_pictures[i]);
}

}  // namespace moomill
