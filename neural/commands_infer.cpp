#include "neural/commands_infer.h"

#include <fmt/format.h>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "neural/dataset_source.h"
#include "neural/evaluate.h"
#include "neural/identify.h"
#include "neural/pose_file.h"
#include "neural/speed.h"

namespace moomill {

namespace fs = std::filesystem;
using torch::Tensor;

Evaluation evaluation_of(bool plain, const std::string& precision) {
  Evaluation evaluation;
  evaluation.fused = !plain;
  if (precision == "bfloat16") {
    if (plain) input_error("--plain computes in float32 only; leave out --precision bfloat16, or --plain");
    if (!has_bfloat16()) input_error("--precision bfloat16: this processor does not multiply bfloat16; use float32");
    evaluation.precision = Precision::bfloat16;
  } else if (precision != "float32") {
    input_error("--precision {}: is neither float32 nor bfloat16", precision);
  }
  return evaluation;
}

namespace {

// Before anything is computed that could then not be written.
void require_folder(const fs::path& out) {
  std::error_code ignored;
  if (!out.empty() && fs::exists(out, ignored) && !fs::is_directory(out, ignored))
    input_error("-o {}: is a file; name a folder", out.string());
}

Model open_model(const ModelChoice& choice) {
  const Evaluation evaluation = evaluation_of(choice.plain, choice.precision);
  Model model = load_model(choice.model);
  model.geometry->evaluation = evaluation;
  if (!model.texture.is_empty()) model.texture->evaluation = evaluation;
  return model;
}

std::vector<Split> splits_of(const std::string& name) {
  if (name == "all") return {Split::train, Split::validate, Split::test};
  for (const Split split : {Split::train, Split::validate, Split::test})
    if (name == name_of(split)) return {split};
  input_error("--split {}: is none of train, validate, test, all", name);
}

std::unique_ptr<SampleSource> open_source(const DatasetChoice& choice, bool color, const CommandTools& tools) {
  std::vector<int> coats;
  if (color) coats = choice.coats.empty() ? coats_of_dataset(choice.dataset) : choice.coats;
  return std::make_unique<SampleSource>(choice.dataset, coats, choice.cache,
                                        [&](const std::string& what, std::size_t done, std::size_t of) {
                                          if (tools.progress) tools.progress(done, of, "packing " + what);
                                        });
}

std::vector<ViewId> views_of(const SampleSource& source, const DatasetChoice& choice) {
  std::vector<int> frames;
  for (const Split split : splits_of(choice.split))
    for (const int frame : source.frames(split)) frames.push_back(frame);
  if (frames.empty())
    input_error("{}: the {} split has no frames; choose another split or a larger dataset", choice.dataset.string(),
                choice.split);
  std::sort(frames.begin(), frames.end());
  return chosen_views(frames, source.cameras(), choice.every_frame, choice.every_camera, choice.max_views);
}

void print(const CommandTools& tools, const std::string& text) {
  if (tools.print) tools.print(text);
}

std::function<void(int, int)> progress_of(const CommandTools& tools, const std::string& stage) {
  return [&tools, stage](int done, int all) {
    if (tools.progress) tools.progress(static_cast<std::size_t>(done), static_cast<std::size_t>(all), stage);
  };
}

int finish(const std::vector<Measure>& measures, bool enforce, const CommandTools& tools) {
  int missed = 0;
  for (const Measure& m : measures) {
    if (!m.at_most && !m.at_least) continue;
    missed += !m.holds();
    print(tools, fmt::format("{:<6} {}: {:.4g}{} (bound: {} {:.4g})\n", m.holds() ? "ok" : "MISSED", m.name, m.value,
                             m.unit.empty() ? "" : " " + m.unit, m.at_most ? "at most" : "at least",
                             m.at_most ? *m.at_most : *m.at_least));
  }
  return enforce && missed > 0 ? 1 : 0;
}

// The code of a photographed animal: silhouette from the photo, NNOPCS from its pose.
Tensor code_of_photo(Model& model, const PhotoChoice& choice) {
  require_texture(model);
  if (choice.mask.empty() || choice.pose.empty())
    input_error("--photo {}: comes without {}; give both, a photo is encoded with silhouette and pose",
                choice.picture.string(), choice.mask.empty() ? "--photo-mask" : "--photo-pose");
  const Photo photo = read_photo(choice.picture, choice.mask);
  const PoseFile file = read_pose_file(choice.pose);
  if (!file.keypoints.defined()) input_error("{}: has no \"keypoints\"; add them", choice.pose.string());
  if (!file.camera)
    input_error("{}: has no \"camera\"; add the one that took {}", choice.pose.string(), choice.picture.string());
  if (file.camera->width != photo.mask.size(1) || file.camera->height != photo.mask.size(0))
    input_error("{}: its camera takes {} x {} pixels, {} has {} x {}; give the camera of that picture",
                choice.pose.string(), file.camera->width, file.camera->height, choice.picture.string(),
                photo.mask.size(1), photo.mask.size(0));
  const PosedAnimal animal = pose_animal(model.geometry, file.keypoints, choice.pose.string());
  const AnimalView view = view_animal(model.geometry, animal, *file.camera);
  const ViewMaps maps = render_surface(model.geometry, view, photo.mask, {}, Surface::nnopcs);
  return encode_coats(model, photo.color.unsqueeze(0), maps.mask, maps.nnopcs);
}

void write_exr(const fs::path& file, const Tensor& planes, const std::vector<std::string>& names) {  // planes [C, h, w]
  const Tensor data = planes.contiguous();
  const std::int64_t plane = data.size(1) * data.size(2);
  std::vector<ExrChannel> channels;
  for (std::size_t c = 0; c < names.size(); ++c) {
    const std::int64_t from = std::min<std::int64_t>(static_cast<std::int64_t>(c), data.size(0) - 1);
    channels.push_back({names[c], data.data_ptr<float>() + from * plane, nullptr, 1});
  }
  const std::vector<std::uint8_t> bytes =
      encode_exr(static_cast<int>(data.size(2)), static_cast<int>(data.size(1)), channels);
  write_file_atomically(file, bytes.data(), bytes.size());
}

Image8 with_alpha(const Image8& rgb, const Image8& alpha) {
  Image8 out(rgb.width, rgb.height, 4);
  for (int y = 0; y < out.height; ++y)
    for (int x = 0; x < out.width; ++x) {
      for (int c = 0; c < 3; ++c) out.at(x, y, c) = rgb.at(x, y, c);
      out.at(x, y, 3) = alpha.at(x, y);
    }
  return out;
}

// Where the numbers of a render command come from.
class RenderInputs {
 public:
  RenderInputs(const RenderCommand& command, Model& model, const CommandTools& tools)
      : command_(command), model_(model) {
    const bool by_number = command.frame || command.camera || command.coat;
    if (by_number && command.dataset.empty())
      input_error(
          "--frame, --camera and --coat are numbers of a dataset; name it with --dataset, or give files instead");
    if (command.frame && !command.pose.empty()) input_error("--frame and --pose both give a pose; leave one out");
    if (!command.frame && command.pose.empty()) input_error("no pose is given; add --dataset and --frame, or --pose");
    if (command.camera && !command.camera_file.empty())
      input_error("--camera and --camera-file both give a camera; leave one out");
    if ((command.coat ? 1 : 0) + !command.photo.picture.empty() + !command.code.empty() > 1)
      input_error("--coat, --photo and --code each give a texture; give one of them");
    if (by_number) {
      DatasetChoice choice;
      choice.dataset = command.dataset;
      choice.cache = command.cache;
      if (command.coat) choice.coats = {*command.coat};
      source_ = open_source(choice, command.coat.has_value(), tools);
    }
    if (!command.pose.empty()) file_ = read_pose_file(command.pose);
  }

  Tensor keypoints() const {
    if (command_.frame)
      return view(*command_.frame, command_.camera ? *command_.camera : source_->cameras().front(), -1).keypoints;
    if (!file_.keypoints.defined()) input_error("{}: has no \"keypoints\"; add them", command_.pose.string());
    return file_.keypoints;
  }

  CameraRecord camera() const {
    CameraRecord camera;
    if (command_.camera) {
      camera = camera_of(view(command_.frame ? *command_.frame : any_frame(), *command_.camera, -1));
    } else if (!command_.camera_file.empty()) {
      camera = read_camera_file(command_.camera_file);
    } else if (file_.camera) {
      camera = *file_.camera;
    } else {
      input_error("no camera is given; add --camera, --camera-file, or a \"camera\" to the pose file");
    }
    if (command_.width == 0 && command_.height == 0) return camera;
    if (command_.width < 1 || command_.height < 1 || command_.width > 16384 || command_.height > 16384)
      input_error("--resolution {}x{}: give two numbers from 1 to 16384", command_.width, command_.height);
    return resized(camera, command_.width, command_.height);
  }

  // [1, z], or undefined where no texture is asked for.
  Tensor code() const {
    if (!command_.photo.picture.empty()) return code_of_photo(model_, command_.photo);
    if (!command_.code.empty()) {
      const CodeSet set = read_codes(command_.code);
      if (command_.code_row < 0 || command_.code_row >= set.codes.size(0))
        input_error("{}: has {} codes, no row {}; rows count from 0", command_.code.string(), set.codes.size(0),
                    command_.code_row);
      if (set.codes.size(1) != model_.config.model.global_features)
        input_error("{}: its codes have {} numbers, the model's {}; embed with this model", command_.code.string(),
                    set.codes.size(1), model_.config.model.global_features);
      return set.codes.slice(0, command_.code_row, command_.code_row + 1);
    }
    if (!command_.coat) return {};
    const std::optional<int> frame = command_.coat_frame ? command_.coat_frame : command_.frame;
    const std::optional<int> camera = command_.coat_camera ? command_.coat_camera : command_.camera;
    if (!frame || !camera)
      input_error("--coat {}: which view shows it is not said; add --coat-frame and --coat-camera", *command_.coat);
    require_texture(model_);
    const FullView seen = view(*frame, *camera, *command_.coat);
    const PosedAnimal animal = pose_animal(model_.geometry, seen.keypoints, fmt::format("frame {}", *frame));
    const ViewMaps maps =
        render_maps(model_.geometry, view_animal(model_.geometry, animal, camera_of(seen)), animal, {});
    return encode_coats(model_, seen.color.unsqueeze(0), maps.mask, maps.nnopcs);
  }

 private:
  FullView view(int frame, int camera, int coat) const { return source_->view({frame, camera, coat}); }
  int any_frame() const {
    for (const Split split : {Split::test, Split::validate, Split::train})
      if (const std::vector<int> frames = source_->frames(split); !frames.empty()) return frames.front();
    input_error("{}: has no frames", command_.dataset.string());
  }

  const RenderCommand& command_;
  Model& model_;
  std::unique_ptr<SampleSource> source_;
  PoseFile file_;
};

}  // namespace

int run_render(const RenderCommand& command, const CommandTools& tools) {
  require_folder(command.out);
  Model model = open_model(command.model);
  const RenderInputs inputs(command, model, tools);
  const Tensor code = inputs.code();
  const std::string origin = command.pose.empty()
                                 ? fmt::format("{}, frame {}", command.dataset.string(), *command.frame)
                                 : command.pose.string();
  const PosedAnimal animal = pose_animal(model.geometry, inputs.keypoints(), origin);
  const AnimalView view = view_animal(model.geometry, animal, inputs.camera());
  RefineOptions refine;
  refine.mask_cell = command.every_pixel ? 1 : command.mask_cell;
  refine.surface_cell = command.every_pixel ? 1 : command.surface_cell;
  std::int64_t points = 0;
  const ViewMaps maps = render_maps(model.geometry, view, animal, refine, Surface::depth_and_nnopcs, &points);
  const Image8 mask = picture_of(maps.mask);
  Image8 mask1(mask.width, mask.height, 1);
  for (std::size_t i = 0; i < mask1.data.size(); ++i) mask1.data[i] = mask.data[3 * i];
  write_png(command.out / "mask.png", mask1);
  write_exr(command.out / "depth.exr", maps.depth.unsqueeze(0), exr_channel_names(Modality::depth));
  if (maps.nnopcs.defined()) {
    write_png(command.out / "nnopcs.png", nnopcs_picture(maps.nnopcs, maps.mask));
    write_exr(command.out / "nnopcs.exr", maps.nnopcs, exr_channel_names(Modality::nnopcs));
  }
  if (code.defined()) {
    const Tensor color = render_color(model, code, view, animal, maps.mask, refine);
    write_png(command.out / "color.png", with_alpha(picture_of(color[0]), mask1));
  }
  print(tools, fmt::format("{}: {} x {} pixels, {} of them inside, {} points evaluated\n", command.out.string(),
                           view.camera.width, view.camera.height, maps.mask.sum().item<std::int64_t>(), points));
  return 0;
}

int run_eval(const EvalCommand& command, const CommandTools& tools) {
  require_folder(command.out);
  Model model = open_model(command.model);
  if (!command.geometry_only) require_texture(model);
  const std::unique_ptr<SampleSource> opened = open_source(command.data, !command.geometry_only, tools);
  const SampleSource& source = *opened;
  require_fit(model, source, command.data.dataset.string());
  EvaluateOptions options;
  options.views = views_of(source, command.data);
  options.split = command.data.split;
  options.color = !command.geometry_only;
  options.true_codes = command.true_codes;
  options.code_camera_shift = command.code_camera_shift;
  options.pictures = command.pictures;
  options.progress = progress_of(tools, "evaluating");
  options.stop = tools.stop;
  const EvaluationResult result = evaluate(model, source, options);
  print(tools, markdown(result, model));
  if (!command.out.empty()) write_evaluation(result, model, command.out);
  return finish(measures_of(result), command.enforce, tools);
}

int run_embed(const EmbedCommand& command, const CommandTools& tools) {
  if (command.out.extension() != ".npy")
    input_error("--out {}: a file of codes ends in .npy; name it so", command.out.string());
  Model model = open_model(command.model);
  require_texture(model);
  CodeSet set;
  if (!command.data.dataset.empty() && !command.photo.picture.empty())
    input_error("a dataset and a photo are given; embed one of them at a time");
  if (command.data.dataset.empty()) {
    if (command.photo.picture.empty())
      input_error("nothing to embed is given; name a dataset, or a photo with --photo");
    set.codes = code_of_photo(model, command.photo);
    set.views = {{-1, -1, -1}};
    set.names = {command.photo_name};
    set.dataset = command.photo.picture.filename().string();
  } else {
    const std::unique_ptr<SampleSource> opened = open_source(command.data, true, tools);
    const SampleSource& source = *opened;
    require_fit(model, source, command.data.dataset.string());
    EmbedOptions options;
    options.true_maps = command.true_maps;
    options.refine.surface_cell = command.surface_cell;
    options.progress = progress_of(tools, "embedding");
    options.stop = tools.stop;
    set = embed(model, source, views_of(source, command.data), options);
  }
  set.model = command.model.model.filename().string();
  write_codes(command.out, set);
  print(tools, fmt::format("{}: {} codes of {} numbers\n", command.out.string(), set.codes.size(0), set.codes.size(1)));
  return 0;
}

int run_identify(const IdentifyCommand& command, const CommandTools& tools) {
  require_folder(command.out);
  if (command.distance != "cosine" && command.distance != "euclidean")
    input_error("--distance {}: is neither cosine nor euclidean", command.distance);
  const CodeDistance distance = command.distance == "cosine" ? CodeDistance::cosine : CodeDistance::euclidean;
  CodeSet queries = read_codes(command.queries);
  CodeSet gallery = command.gallery.empty() ? queries : read_codes(command.gallery);
  if (gallery.codes.size(0) == 0)
    input_error("{}: holds no codes to compare with",
                (command.gallery.empty() ? command.queries : command.gallery).string());
  std::string calibration;
  if (!command.calibrate.empty()) {
    const CodeSet known = read_codes(command.calibrate);
    Tensor map;
    try {
      map = scatter_normalisation(known);
    } catch (const InputError& e) {
      input_error("--calibrate {}: {}", command.calibrate.string(), e.what());
    }
    queries = mapped(std::move(queries), map);
    gallery = mapped(std::move(gallery), map);
    calibration = fmt::format("{} codes of {}", known.codes.size(0), known.dataset);
  }
  const std::vector<QueryMatch> matches = match_codes(queries, gallery, distance, disjoint_of(queries, gallery));
  std::string lines;
  bool known = false;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const ViewId& v = queries.views[i];
    known = known || matches[i].has_match;
    Json line{
        {"frame", v.frame}, {"camera", v.camera}, {"coat", v.coat}, {"distance", number_json(matches[i].distance)}};
    if (matches[i].nearest >= 0) {
      const auto nearest = static_cast<std::size_t>(matches[i].nearest);
      line["named"] = gallery.names[nearest];
      line["named_coat"] = gallery.views[nearest].coat;
    } else {
      line["named"] = nullptr;
      line["named_coat"] = nullptr;
    }
    lines += line.dump() + "\n";
    if (matches.size() <= 20)
      print(tools, fmt::format("query {}: {} (distance {:.4f})\n", i,
                               matches[i].nearest < 0 ? "nothing to compare with" : line["named"].get<std::string>(),
                               matches[i].distance));
  }
  if (!command.out.empty()) write_file_atomically(command.out / "names.jsonl", lines);
  if (!known) return 0;  // whose the queries are is not known, or they have nobody to find
  IdentificationResult result = identify_codes(queries, gallery, distance);
  result.calibration = calibration;
  print(tools, markdown(result));
  if (!command.out.empty()) write_identification(result, command.out);
  return finish(measures_of(result), command.enforce, tools);
}

int run_speed(const SpeedCommand& command, const CommandTools& tools) {
  require_folder(command.out);
  if (command.width < 1 || command.height < 1 || command.views < 1 || command.repeats < 1)
    input_error("{}x{} pixels, {} views, {} repeats: all of them must be 1 or more", command.width, command.height,
                command.views, command.repeats);
  SpeedOptions options;
  options.untrained = command.model.model.empty();
  Model model;
  if (options.untrained) {
    if (command.config.empty()) input_error("neither a model nor a configuration is given; name one of them");
    model.config = read_config(command.config);
    torch::manual_seed(model.config.seed);
    model.geometry = GeometryNetwork(model.config.model);
    model.texture = TextureNetwork(model.config.model);
    model.geometry->eval();
    model.texture->eval();
    model.geometry->evaluation = model.texture->evaluation = evaluation_of(command.model.plain, command.model.precision);
  } else {
    model = open_model(command.model);
    if (model.texture.is_empty()) {  // encoding takes as long with random weights
      torch::manual_seed(model.config.seed);
      model.texture = TextureNetwork(model.config.model);
      model.texture->eval();
    }
  }
  DatasetChoice data = command.data;
  if (data.coats.empty()) data.coats = {coats_of_dataset(data.dataset).front()};
  const std::unique_ptr<SampleSource> opened = open_source(data, true, tools);
  const SampleSource& source = *opened;
  require_fit(model, source, data.dataset.string());
  options.width = command.width;
  options.height = command.height;
  options.views = command.views;
  options.repeats = command.repeats;
  options.surface_cell = command.surface_cell;
  SpeedResult result = measure_speed(model, source, options);
  const std::int64_t parameters = count_parameters(*model.geometry) + count_parameters(*model.texture);
  result.model = options.untrained
                     ? fmt::format("random weights of {} ({:.1f} million parameters)",
                                   command.config.filename().string(), static_cast<double>(parameters) / 1e6)
                     : fmt::format("{} ({:.1f} million parameters)", command.model.model.filename().string(),
                                   static_cast<double>(parameters) / 1e6);
  print(tools, markdown(result));
  if (!command.out.empty()) write_speed(result, command.out);
  return 0;
}

}  // namespace moomill
