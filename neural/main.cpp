// The command line of netepu: commands, options, help.
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>
#include <torch/torch.h>

#include <unistd.h>

#include <cstdlib>

#include "generator/command_line.h"
#include "generator/core/data_root.h"
#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/progress_bar.h"
#include "neural/commands_infer.h"
#include "neural/dataset_source.h"
#include "neural/training.h"

namespace {

using namespace moomill;
namespace fs = std::filesystem;

struct TrainCommand {
  std::string dataset, config, out, geometry, cache, precision = "float32", device = "auto";
  std::vector<int> coats;
  int threads = 0;
  std::int64_t max_steps = 0;
  bool plain = false, profile = false;
};

// `--config compact` is neural/configs/compact.toml of the program's data; anything with a slash or an ending is a file.
fs::path config_file(const std::string& name) {
  if (name.find('/') != std::string::npos || fs::path(name).has_extension()) return name;
  return data_root() / "neural/configs" / (name + ".toml");
}

void use_threads(int threads) {
  at::set_num_threads(threads > 0 ? threads : hardware_threads());
  at::globalContext().setFlushDenormal(true);
}

// `auto` is the GPU where LibTorch sees one.
torch::Device device_of(const std::string& name) {
  const bool cuda = torch::cuda::is_available();
  if (name == "cuda" && !cuda) input_error("--device cuda: LibTorch sees no CUDA device here; leave the option out to compute on the CPU");
  return cuda && name != "cpu" ? torch::kCUDA : torch::kCPU;
}

TrainingControl control_of(const TrainCommand& c) {
  TrainingControl control;
  control.stop = &stop_wanted;
  control.log = [](const std::string& line) { spdlog::info(line); };
  control.device = device_of(c.device);
  if (control.device.is_cuda() && c.precision != "float32")
    input_error("--precision {}: is of the CPU's operators; leave it out on a GPU, or add --device cpu", c.precision);
  control.evaluation = evaluation_of(c.plain || control.device.is_cuda(), c.precision);
  control.max_steps = c.max_steps;
  control.profile = c.profile;
  return control;
}

int run_train(const TrainCommand& c, bool texture) {
  use_threads(c.threads);
  const TrainingControl control = control_of(c);
  const NetepuConfig config = read_config(config_file(c.config));
  std::vector<int> coats = c.coats;
  if (texture && coats.empty()) coats = coats_of_dataset(c.dataset);
  const SampleSource source(c.dataset, coats, c.cache, [](const std::string& what, std::size_t done, std::size_t of) {
    if (done == of) spdlog::info("packed {}", what);
  });
  spdlog::info(source.describe());
  const TrainingEnd end = texture ? train_texture(source, config, c.geometry, c.out, control)
                                  : train_geometry(source, config, c.out, control);
  if (end == TrainingEnd::stopped && stop_wanted.load()) return 1;  // as moomill generate: what comes after must not take it for done
  if (end == TrainingEnd::finished) spdlog::info("{}: trained; the best model is {}", c.out, (fs::path(c.out) / "model.netepu").string());
  return 0;
}

void add_train_options(CLI::App* app, TrainCommand& c) {
  app->add_option("dataset", c.dataset, "dataset folder")->required()->type_name("DIR");
  app->add_option("--config", c.config, "configuration file, or the name of one that ships: compact, paper, nepu")
      ->required()
      ->type_name("FILE.toml");
  app->add_option("-o,--out", c.out, "folder of the run; a run that is there already goes on")->required()->type_name("DIR");
  app->add_option("--cache", c.cache, "folder of the packed samples; default: beside the dataset")->type_name("DIR");
  app->add_option("--precision", c.precision, "of the larger products")->type_name("float32|bfloat16")->check(CLI::IsMember({"float32", "bfloat16"}));
  app->add_option("--device", c.device, "a GPU runs the plain operators in float32")
      ->type_name("auto|cpu|cuda")
      ->check(CLI::IsMember({"auto", "cpu", "cuda"}));
  app->add_flag("--plain", c.plain, "straightforward LibTorch instead of the fused operators");
  app->add_flag("--profile", c.profile, "tell where a step's time goes");
  app->add_option("--threads", c.threads, "0: one per core")->type_name("N")->check(CLI::Range(0, 4096));
  app->add_option("--max-steps", c.max_steps, "save and stop after so many steps")->type_name("N")->check(CLI::Range(0, 1000000000));
}

// --- commands that use a trained model ---

void add_model_options(CLI::App* app, ModelChoice& c, int& threads) {
  app->add_option("--precision", c.precision, "of the larger products")->type_name("float32|bfloat16")->check(CLI::IsMember({"float32", "bfloat16"}));
  app->add_flag("--plain", c.plain, "straightforward LibTorch instead of the fused operators");
  app->add_option("--threads", threads, "0: one per core")->type_name("N")->check(CLI::Range(0, 4096));
}

void add_data_options(CLI::App* app, DatasetChoice& c) {
  app->add_option("--cache", c.cache, "folder of the packed samples; default: beside the dataset")->type_name("DIR");
  app->add_option("--coats", c.coats, "these coats only")->type_name("0,11")->delimiter(',');
  app->add_option("--split", c.split, "train, validate, test, or all")->type_name("NAME")->check(CLI::IsMember({"train", "validate", "test", "all"}));
  app->add_option("--every-frame", c.every_frame, "every N-th frame of the split")->type_name("N")->check(CLI::Range(1, 1000000));
  app->add_option("--every-camera", c.every_camera, "every N-th camera")->type_name("N")->check(CLI::Range(1, 1000000));
  app->add_option("--max-views", c.max_views, "so many pairs of frame and camera, spread evenly; 0: all")->type_name("N")->check(CLI::Range(0, 1000000000));
}

void add_photo_options(CLI::App* app, PhotoChoice& c) {
  CLI::Option* photo = app->add_option("--photo", c.picture, "a picture of the animal")->type_name("FILE");
  app->add_option("--photo-mask", c.mask, "its silhouette, white on black, of the same size")->type_name("FILE")->needs(photo);
  app->add_option("--photo-pose", c.pose, "its keypoints and camera")->type_name("FILE.json")->needs(photo);
}

int with_tools(const char* unit, int threads, const std::function<int(const CommandTools&)>& body) {
  use_threads(threads);
  ProgressBar bar(unit);
  CommandTools tools;
  tools.progress = [&](std::size_t done, std::size_t total, const std::string& stage) { bar.update(done, total, stage); };
  tools.stop = [] { return stop_wanted.load(); };
  tools.print = [](const std::string& text) { std::fputs(text.c_str(), stdout); };
  return body(tools);
}

// What the options of these commands are stored in, for as long as the program parses and runs.
struct InferCommands {
  RenderCommand render;
  EvalCommand eval;
  EmbedCommand embed;
  IdentifyCommand identify;
  SpeedCommand speed;
  std::string resolution, speed_config;
  int threads = 0;
};

// "1024x768"
void parse_resolution(const std::string& text, int& width, int& height) {
  char rest = 0;
  if (!text.empty() && (std::sscanf(text.c_str(), "%dx%d%c", &width, &height, &rest) != 2 || width < 1 || height < 1))
    input_error("--resolution {}: give it as WIDTHxHEIGHT, e.g. 1024x768", text);
}

void add_render_command(CLI::App& app, InferCommands& all, int& status) {
  RenderCommand& r = all.render;
  CLI::App* c = add_command(app, "render", "Silhouette, depth, NNOPCS and colour of a pose before a camera",
                            "netepu render model.netepu --dataset out/nepumoo --frame 12 --camera 3 --coat 0 -o out/view", status, [&] {
                              parse_resolution(all.resolution, r.width, r.height);
                              return with_tools("views", all.threads, [&](const CommandTools& tools) { return run_render(r, tools); });
                            });
  c->add_option("model", r.model.model, "trained model")->required()->type_name("MODEL");
  c->add_option("-o,--out", r.out, "folder of the pictures")->required()->type_name("DIR");
  c->add_option("--dataset", r.dataset, "where frame, camera and coat are numbers of")->type_name("DIR");
  c->add_option("--cache", r.cache, "folder of its packed samples; default: beside it")->type_name("DIR");
  c->add_option("--frame", r.frame, "pose of this frame")->type_name("N");
  c->add_option("--pose", r.pose, "pose of this file: {\"keypoints\": [[x, y, z], ...]}, metres")->type_name("FILE.json");
  c->add_option("--camera", r.camera, "camera of the dataset")->type_name("N");
  c->add_option("--camera-file", r.camera_file, "{world_to_camera, fx, fy, cx, cy, width, height}; default: the pose file's")->type_name("FILE.json");
  c->add_option("--resolution", all.resolution, "instead of the camera's own")->type_name("WxH");
  CLI::Option* coat = c->add_option("--coat", r.coat, "texture of the dataset's view with this coat")->type_name("N");
  c->add_option("--coat-frame", r.coat_frame, "frame of that view; default: the rendered one")->type_name("N")->needs(coat);
  c->add_option("--coat-camera", r.coat_camera, "camera of that view; default: the rendered one")->type_name("N")->needs(coat);
  add_photo_options(c, r.photo);
  CLI::Option* code = c->add_option("--code", r.code, "texture of a file that embed wrote")->type_name("FILE.npy");
  c->add_option("--code-row", r.code_row, "row of it")->type_name("N")->needs(code);
  c->add_option("--mask-cell", r.mask_cell, "first grid of the silhouette in pixels, a power of two; 0: a 64th of the picture")->type_name("N")->check(CLI::Range(0, 4096));
  c->add_option("--surface-cell", r.surface_cell, "grid between which depth and NNOPCS are interpolated; 1: every pixel")->type_name("N");
  c->add_flag("--every-pixel", r.every_pixel, "no shortcuts: evaluate every pixel of the picture");
  add_model_options(c, r.model, all.threads);
}

void add_infer_commands(CLI::App& app, InferCommands& all, int& status) {
  add_render_command(app, all, status);

  EvalCommand& e = all.eval;
  CLI::App* c = add_command(app, "eval", "Errors of reconstruction on a split, beside the paper's",
                            "netepu eval model.netepu out/nepumoo -o out/eval", status, [&] {
                              return with_tools("views", all.threads, [&](const CommandTools& tools) { return run_eval(e, tools); });
                            });
  c->add_option("model", e.model.model, "trained model")->required()->type_name("MODEL");
  c->add_option("dataset", e.data.dataset, "dataset folder")->required()->type_name("DIR");
  c->add_option("-o,--out", e.out, "folder of the results")->type_name("DIR");
  add_data_options(c, e.data);
  c->add_flag("--geometry-only", e.geometry_only, "leave colour out");
  c->add_flag("--true-codes", e.true_codes, "encode with the dataset's silhouette and NNOPCS, not the model's own");
  c->add_option("--code-camera-shift", e.code_camera_shift, "encode the picture of so many cameras further on")->type_name("N");
  c->add_option("--pictures", e.pictures, "views to show")->type_name("N")->check(CLI::Range(0, 100));
  c->add_flag("--enforce", e.enforce, "exit status 1 where a figure misses its bound");
  add_model_options(c, e.model, all.threads);

  EmbedCommand& m = all.embed;
  c = add_command(app, "embed", "Texture codes of views, or of one photo", "netepu embed model.netepu out/nepumoo -o out/codes.npy",
                  status, [&] {
                    return with_tools("views", all.threads, [&](const CommandTools& tools) { return run_embed(m, tools); });
                  });
  c->add_option("model", m.model.model, "trained model")->required()->type_name("MODEL");
  c->add_option("dataset", m.data.dataset, "dataset folder; without it, a photo")->type_name("DIR");
  c->add_option("-o,--out", m.out, "codes as NumPy; a .jsonl beside it names the views")->required()->type_name("FILE.npy");
  add_data_options(c, m.data);
  add_photo_options(c, m.photo);
  c->add_option("--name", m.photo_name, "whose photo it is, where that is known")->type_name("NAME");
  c->add_flag("--true-maps", m.true_maps, "encode with the dataset's silhouette and NNOPCS, not the model's own");
  c->add_option("--surface-cell", m.surface_cell, "grid between which NNOPCS is interpolated; 1: every pixel")->type_name("N");
  add_model_options(c, m.model, all.threads);

  IdentifyCommand& i = all.identify;
  c = add_command(app, "identify", "Names individuals by their nearest codes, and how often that is right",
                  "netepu identify out/codes.npy -o out/identification", status, [&] {
                    return with_tools("codes", all.threads, [&](const CommandTools& tools) { return run_identify(i, tools); });
                  });
  c->add_option("queries", i.queries, "codes of embed")->required()->type_name("FILE.npy");
  c->add_option("--gallery", i.gallery, "codes of known individuals; default: the queries, other poses and cameras")->type_name("FILE.npy");
  c->add_option("--calibrate", i.calibrate, "codes of the training split; what scatters among views of one coat then counts for less")->type_name("FILE.npy");
  c->add_option("-o,--out", i.out, "folder of the results")->type_name("DIR");
  c->add_option("--distance", i.distance, "between codes")->type_name("cosine|euclidean")->check(CLI::IsMember({"cosine", "euclidean"}));
  c->add_flag("--enforce", i.enforce, "exit status 1 where a figure misses its bound");
  c->add_option("--threads", all.threads, "0: one per core")->type_name("N")->check(CLI::Range(0, 4096));

  SpeedCommand& s = all.speed;
  c = add_command(app, "speed", "Re-identified views a second, and what the shortcuts change",
                  "netepu speed out/nepumoo --model model.netepu -o out/speed", status, [&] {
                    parse_resolution(all.resolution, s.width, s.height);
                    if (!all.speed_config.empty()) s.config = config_file(all.speed_config);
                    return with_tools("views", all.threads, [&](const CommandTools& tools) { return run_speed(s, tools); });
                  });
  c->add_option("dataset", s.data.dataset, "poses, cameras and pictures")->required()->type_name("DIR");
  CLI::Option* speed_model = c->add_option("--model", s.model.model, "trained model")->type_name("MODEL");
  c->add_option("--config", all.speed_config, "random weights of a configuration instead")->type_name("FILE.toml")->excludes(speed_model);
  c->add_option("-o,--out", s.out, "folder of the results")->type_name("DIR");
  c->add_option("--cache", s.data.cache, "folder of the packed samples; default: beside the dataset")->type_name("DIR");
  c->add_option("--resolution", all.resolution, "of the rendered maps; default: 1024x768")->type_name("WxH");
  c->add_option("--views", s.views, "so many")->type_name("N")->check(CLI::Range(1, 10000));
  c->add_option("--repeats", s.repeats, "of every view")->type_name("N")->check(CLI::Range(1, 1000));
  c->add_option("--surface-cell", s.surface_cell, "grid of the interpolated variant")->type_name("N");
  add_model_options(c, s.model, all.threads);
}

int run(int argc, char** argv) {
  CLI::App app("Neural Texture Puppeteer: trains, renders and identifies animals on datasets of moomill.", "netepu");
  app.set_version_flag("--version", "netepu " MOOMILL_VERSION);
  app.require_subcommand(1);
  add_example(&app, "netepu train-geometry out/nepumoo --config compact -o out/geometry");
  int status = 0;

  TrainCommand geometry, texture;
  CLI::App* c = add_command(app, "train-geometry", "Train silhouette, depth and NNOPCS from keypoints",
                            "netepu train-geometry out/nepumoo --config compact -o out/geometry", status,
                            [&] { return run_train(geometry, false); });
  add_train_options(c, geometry);
  c = add_command(app, "train-texture", "Train colour from one masked view, on a trained geometry",
                  "netepu train-texture out/nepumoo --config compact --geometry out/geometry/model.netepu -o out/texture", status,
                  [&] { return run_train(texture, true); });
  add_train_options(c, texture);
  c->add_option("--geometry", texture.geometry, "trained geometry, its weights stay as they are")->required()->type_name("MODEL");
  c->add_option("--coats", texture.coats, "train on these coats only")->type_name("0,11")->delimiter(',');

  std::string whole, packed;
  c = add_command(app, "pack", "Write a model with half-precision weights, for shipping", "netepu pack out/texture/model.netepu -o compact.netepu",
                  status, [&] {
                    save_model(packed, load_model(whole), true);
                    return 0;
                  });
  c->add_option("model", whole, "trained model")->required()->type_name("MODEL");
  c->add_option("-o,--out", packed, "file to write")->required()->type_name("FILE");

  InferCommands infer;
  add_infer_commands(app, infer, status);
  return parse_and_run(app, argc, argv, status);
}

// Threads that wait must not spin: a step is many short parallel parts, and others (drawing samples, other programs) want the
// core. OpenMP and OpenBLAS read how to wait when they are loaded, before main(), so the program starts itself once more with it
// in its environment. OpenBLAS keeps to one thread: what is large runs in the fused operators, and sums stay in one order.
void start_with_quiet_threads(char** argv) {
  if (std::getenv("OMP_WAIT_POLICY") && std::getenv("OPENBLAS_NUM_THREADS")) return;
  setenv("OMP_WAIT_POLICY", "passive", 0);
  setenv("OPENBLAS_NUM_THREADS", "1", 0);
  ::execv("/proc/self/exe", argv);  // where that fails, all still works, more slowly
}

}  // namespace

int main(int argc, char** argv) {
  start_with_quiet_threads(argv);
  keep_memory_mapped();
  return run_program("netepu", "use a smaller batch, or [texture] micro_batch", [&] {
    try {
      return run(argc, argv);
    } catch (const c10::Error& e) {  // what() has a backtrace
      const std::string what = e.what_without_backtrace();
      run_error("LibTorch refused: {}", what.substr(0, what.find('\n')));
    }
  });
}
