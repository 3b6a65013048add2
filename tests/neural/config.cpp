#include "neural/config.h"

#include "generator/core/error.h"
#include "tests/neural/doctest_torch.h"
#include "tests/temporary_file.h"

using namespace moomill;
using test::TemporaryFile;

namespace {

std::string refusal(const std::string& text) {
  const TemporaryFile file("a.toml", text);
  try {
    read_config(file.path);
  } catch (const InputError& e) {
    return e.what();
  }
  return "";
}

}  // namespace

TEST_CASE("the shipped configurations are read, and paper.toml says the defaults") {
  const std::filesystem::path folder = std::filesystem::path(MOOMILL_SOURCE_DIR) / "neural/configs";
  NetepuConfig paper = read_config(folder / "paper.toml");
  CHECK(paper.model == ModelConfig{});
  CHECK(to_json(paper).at("geometry") == to_json(NetepuConfig{}).at("geometry"));
  const NetepuConfig nepu = read_config(folder / "nepu.toml");
  CHECK(nepu.model.neighbours == 12);
  CHECK(nepu.geometry.squared_depth);
  const NetepuConfig compact = read_config(folder / "compact.toml");
  CHECK(compact.model.local_features < paper.model.local_features);
}

TEST_CASE("a configuration comes back from its JSON") {
  NetepuConfig c;
  c.seed = 99;
  c.model.image_channels = {8, 24};
  c.geometry.optimiser.schedule.rate = 0.125;
  c.texture.micro_batch = 3;
  CHECK(to_json(config_from_json(to_json(c), "f")) == to_json(c));
  nlohmann::json broken = to_json(c);
  broken["model"].erase("head_width");
  CHECK_THROWS_WITH_AS(config_from_json(broken, "m.netepu"), doctest::Contains("m.netepu: its configuration has no usable \"head_width\""),
                       InputError);
}

TEST_CASE("mistakes in a configuration are named with line and mend") {
  CHECK(refusal("[model]\nlocal_feature = 64\n").find(":2: unknown key 'local_feature' in [model]; did you mean 'local_features'?") !=
        std::string::npos);
  CHECK(refusal("[model]\nlocal_features = 40\n").find("'local_features' must be a multiple of 16, not 40") != std::string::npos);
  CHECK(refusal("[geometry]\nbatch = 0\n").find(":2: 'batch' in [geometry]") != std::string::npos);
  CHECK(refusal("[geometry]\nrate = \"fast\"\n").find("'rate' in [geometry]") != std::string::npos);
  CHECK(refusal("[texture]\nencoder_width = 64\n").find("needs both encoder_width and encoder_height") != std::string::npos);
  CHECK(refusal("[model]\nimage_channels = []\n").find("at least one number") != std::string::npos);
  CHECK(refusal("[models]\n").find("did you mean 'model'?") != std::string::npos);
}
