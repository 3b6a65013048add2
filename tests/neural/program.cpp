// Runs netepu itself: exit status 2 and one sentence with the mend for what a user can get wrong, and the whole of training from the
// command line, stopped by a signal and gone on with.
#include <sys/wait.h>

#include <fstream>

#include "generator/dataset/codecs.h"
#include "neural/checkpoint.h"
#include "tests/neural/doctest_torch.h"
#include "tests/neural/tiny_dataset.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

std::string read_all(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

struct Outcome {
  int status = -1;
  std::string out, err;
};

struct Bench {
  test::TemporaryFolder folder;
  Outcome run(const std::string& arguments) const {
    const std::string command = fmt::format("cd '{0}' && '{1}' {2} >out.txt 2>err.txt </dev/null", folder.path.string(), NETEPU_PROGRAM, arguments);
    const int status = std::system(command.c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, read_all(folder.path / "out.txt"), read_all(folder.path / "err.txt")};
  }
  // Status 2, and a last line on stderr that begins with the program and holds `part`; nothing on stdout.
  void refuses(const std::string& arguments, const std::string& part) const {
    const Outcome o = run(arguments);
    INFO(arguments << "\n" << o.err);
    CHECK(o.status == 2);
    CHECK(o.out.empty());
    const auto line = o.err.rfind("netepu: ");
    REQUIRE(line != std::string::npos);
    const std::string said = o.err.substr(line);
    CHECK(said.find(part) != std::string::npos);
    CHECK(std::count(said.begin(), said.end(), '\n') == 1);
  }
  void dataset(const std::string& name, test::TinyOptions options) const { test::write_tiny_dataset(folder.path / name, options); }
  void file(const std::string& name, const std::string& text) const { std::ofstream(folder.path / name) << text; }
};

constexpr const char* small = R"(
[model]
keypoints = 10
local_features = 16
global_features = 16
head_width = 16
head_blocks = 1
encoder_blocks = 1
image_channels = [8, 16]
image_blocks = 1
[geometry]
batch = 8
epochs = 2
validate_every = 1
silhouette_points = 16
surface_points = 16
[texture]
batch = 8
epochs = 1
validate_every = 1
surface_points = 16
)";

}  // namespace

TEST_CASE("netepu refuses what does not fit, in one sentence, with exit status 2") {
  const Bench b;
  test::TinyOptions options;
  options.frames = 60, options.rings = 1, options.coats = 2;
  b.dataset("data", options);
  options.frames = 55;
  b.dataset("other", options);
  options.frames = 51, options.nnopcs = false;
  b.dataset("bare", options);
  options.frames = 12, options.nnopcs = true, options.coats = 1;
  b.dataset("few", options);
  b.file("small.toml", small);
  b.file("other.toml", std::string(small).replace(std::string(small).find("head_blocks = 1"), 15, "head_blocks = 2"));
  b.file("k.toml", std::string(small).replace(std::string(small).find("keypoints = 10"), 14, "keypoints = 25"));
  b.file("bad.toml", "[model]\nlocal_feature = 16\n");

  b.refuses("train-geometri data", "unknown command 'train-geometri'; did you mean 'train-geometry'?");
  b.refuses("train-geometry data -o g", "--config is required");
  if (!torch::cuda::is_available()) b.refuses("train-geometry data --config small.toml -o g --device cuda", "no CUDA device");
  b.refuses("train-geometry absent --config small.toml -o g", "absent");
  b.refuses("train-geometry data --config bad.toml -o g", "bad.toml:2: unknown key 'local_feature'");
  b.refuses("train-geometry data --config nosuch -o g", "nosuch.toml cannot be read");
  b.refuses("train-geometry bare --config small.toml -o g", "no NNOPCS");
  b.refuses("train-geometry data --config k.toml -o g", "set [model] keypoints = 10");
  b.refuses("train-geometry few --config small.toml -o g", "validat");
  CHECK_FALSE(fs::exists(b.folder.path / "g" / "state.netepu"));

  REQUIRE(b.run("train-geometry data --config small.toml -o g").status == 0);
  b.refuses("train-texture data --config other.toml --geometry g/model.netepu -o t", "its [model] is not that of the configuration");
  b.refuses("train-texture data --config small.toml --geometry g/state.netepu -o t", "is a training state, not a model");
  b.refuses("train-texture data --config small.toml --geometry g/model.netepu --coats 7 -o t", "7");
  b.refuses("eval g/state.netepu data", "is a training state");
  b.refuses("eval g/model.netepu bare --geometry-only", "NNOPCS");
  b.refuses("eval g/model.netepu data", "geometry only, no texture networks");
  b.refuses("eval g/model.netepu data --split tests", "tests");
  fs::copy_file(b.folder.path / "g/model.netepu", b.folder.path / "short.netepu");
  fs::resize_file(b.folder.path / "short.netepu", 20000);
  b.refuses("eval short.netepu data", "cut short");
  // One bit of the header: a digit of the configuration.
  std::vector<std::uint8_t> flipped = read_file(b.folder.path / "g/model.netepu");
  const std::string text(flipped.begin(), flipped.end());
  flipped[text.find("\"position_scale\":4") + 17] = '5';
  write_file_atomically(b.folder.path / "flipped.netepu", flipped.data(), flipped.size());
  b.refuses("eval flipped.netepu data", "the hash of its header does not match");
  b.refuses("train-geometry data --config small.toml -o small.toml", "is a file; name a folder");
  b.refuses("eval g/model.netepu data --geometry-only -o small.toml", "is a file; name a folder");
  b.refuses("render g/model.netepu --dataset data --frame 1 --camera 0 --photo-mask m.png -o r", "--photo");
  // A run goes on only with what it began with.
  b.refuses("train-geometry other --config small.toml -o g", "was trained on another dataset");
  CHECK_FALSE(fs::exists(b.folder.path / "t"));

  // A corrupt picture, and one of another size: found when the samples are packed.
  const fs::path depth = b.folder.path / "data/cow_animation_alltextures.blend";
  for (const auto& entry : fs::recursive_directory_iterator(b.folder.path / "data"))
    if (entry.path().filename() == "depth0005.003.exr") {
      fs::remove_all(b.folder.path / "data.cache");
      const std::vector<std::uint8_t> whole = read_file(entry.path());
      write_file_atomically(entry.path(), whole.data(), whole.size() / 2);
      b.refuses("train-geometry data --config small.toml -o g2", "depth0005.003.exr");
      const float three[12] = {};
      const auto wrong = encode_exr(2, 2, {{"R", three, nullptr, 3}, {"G", three, nullptr, 3}, {"B", three, nullptr, 3}});
      write_file_atomically(entry.path(), wrong.data(), wrong.size());
      b.refuses("train-geometry data --config small.toml -o g2", "depth0005.003.exr");
      break;
    }
}

TEST_CASE("a run stopped by SIGTERM saves, says so, and the same command goes on") {
  const Bench b;
  test::TinyOptions options;
  options.frames = 60, options.rings = 1, options.coats = 2;
  b.dataset("data", options);
  b.file("long.toml", std::string(small).replace(std::string(small).find("epochs = 2"), 10, "epochs = 100000"));
  const std::string script = fmt::format(
      "cd '{}' || exit 9\n'{}' train-geometry data --config long.toml -o g >out.txt 2>err.txt </dev/null & P=$!\n"
      "for i in $(seq 1200); do [ -f g/state.netepu ] && break; sleep 0.1; done\nkill -TERM $P; wait $P",
      b.folder.path.string(), NETEPU_PROGRAM);
  const int status = std::system(script.c_str());
  CHECK(WIFEXITED(status));
  CHECK(WEXITSTATUS(status) == 1);  // not done
  CHECK(read_all(b.folder.path / "err.txt").find("the same command goes on from here") != std::string::npos);
  const TensorFile state = read_tensor_file(b.folder.path / "g/state.netepu");
  const std::int64_t step = state.header.at("step");
  CHECK(step > 0);
  const Outcome more = b.run("train-geometry data --config long.toml -o g --max-steps 2");
  CHECK(more.status == 0);
  CHECK(more.err.find(fmt::format("step {}", step)) != std::string::npos);
  CHECK(read_tensor_file(b.folder.path / "g/state.netepu").header.at("step") == step + 2);
}

TEST_CASE("help has an example for every command, and --version names the program") {
  const Bench b;
  CHECK(b.run("--version").out.starts_with("netepu "));
  for (const char* command : {"train-geometry", "train-texture", "render", "eval", "embed", "identify", "speed", "pack"}) {
    const Outcome o = b.run(std::string(command) + " --help");
    CHECK(o.status == 0);
    INFO(command);
    CHECK(o.out.find("Example:\n  netepu " + std::string(command)) != std::string::npos);
  }
}
