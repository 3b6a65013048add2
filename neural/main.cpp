// The command line of netepu: commands, options, help.
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>
#include <torch/torch.h>

#include <unistd.h>

#include <cstdlib>

#include "generator/command_line.h"
#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "neural/dataset_source.h"
#include "neural/training.h"

namespace {

using namespace moomill;
namespace fs = std::filesystem;

struct TrainCommand {
  std::string dataset, config, out, geometry, cache, precision = "float32";
  std::vector<int> coats;
  int threads = 0;
  std::int64_t max_steps = 0;
  bool plain = false, profile = false;
};

// `--config compact` is neural/configs/compact.toml of the program's data; anything with a slash or an ending is a file.
fs::path config_file(const std::string& name) {
  if (name.find('/') != std::string::npos || fs::path(name).has_extension()) return name;
  const char* home = std::getenv("MOOMILL_HOME");
  return fs::path(home ? home : MOOMILL_SOURCE_DIR) / "neural/configs" / (name + ".toml");
}

void use_threads(int threads) {
  at::set_num_threads(threads > 0 ? threads : hardware_threads());
  at::globalContext().setFlushDenormal(true);
}

TrainingControl control_of(const TrainCommand& c) {
  TrainingControl control;
  control.stop = &stop_wanted;
  control.log = [](const std::string& line) { spdlog::info(line); };
  control.evaluation.fused = !c.plain;
  control.evaluation.precision = c.precision == "bfloat16" ? Precision::bfloat16 : Precision::float32;
  control.max_steps = c.max_steps;
  control.profile = c.profile;
  return control;
}

int run_train(const TrainCommand& c, bool texture) {
  use_threads(c.threads);
  const NetepuConfig config = read_config(config_file(c.config));
  std::vector<int> coats = c.coats;
  if (texture && coats.empty()) coats = coats_of_dataset(c.dataset);
  const SampleSource source(c.dataset, coats, c.cache, [](const std::string& what, std::size_t done, std::size_t of) {
    if (done == of) spdlog::info("packed {}", what);
  });
  spdlog::info(source.describe());
  const TrainingControl control = control_of(c);
  const TrainingEnd end = texture ? train_texture(source, config, c.geometry, c.out, control)
                                  : train_geometry(source, config, c.out, control);
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
  app->add_flag("--plain", c.plain, "straightforward LibTorch instead of the fused operators");
  app->add_flag("--profile", c.profile, "tell where a step's time goes");
  app->add_option("--threads", c.threads, "0: one per core")->type_name("N")->check(CLI::Range(0, 4096));
  app->add_option("--max-steps", c.max_steps, "save and stop after so many steps")->type_name("N")->check(CLI::Range(0, 1000000000));
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

  return parse_and_run(app, argc, argv, status);
}

}  // namespace

// Threads that wait must not spin: a step is many short parallel parts, and others (drawing samples, other programs) want the
// core. OpenMP and OpenBLAS read how to wait when they are loaded, before main(), so the program starts itself once more with it
// in its environment. OpenBLAS keeps to one thread: what is large runs in the fused operators, and sums stay in one order.
void start_with_quiet_threads(char** argv) {
  if (std::getenv("OMP_WAIT_POLICY") && std::getenv("OPENBLAS_NUM_THREADS")) return;
  setenv("OMP_WAIT_POLICY", "passive", 0);
  setenv("OPENBLAS_NUM_THREADS", "1", 0);
  ::execv("/proc/self/exe", argv);  // where that fails, all still works, more slowly
}

int main(int argc, char** argv) {
  start_with_quiet_threads(argv);
  keep_memory_mapped();
  return run_program("netepu", "use a smaller batch, or [texture] micro_batch", [&] { return run(argc, argv); });
}
