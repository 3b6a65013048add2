#include "neural/checkpoint.h"

#include <fstream>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "tests/neural/doctest_torch.h"
#include "tests/temporary_file.h"

using namespace moomill;
using test::TemporaryFile;

namespace {

NetepuConfig small_config() {
  NetepuConfig c;
  c.model.keypoints = 5;
  c.model.local_features = 16, c.model.global_features = 8, c.model.head_width = 16, c.model.head_blocks = 1, c.model.encoder_blocks = 1;
  c.model.image_channels = {4, 8}, c.model.image_blocks = 1;
  return c;
}

Model small_model(bool texture) {
  torch::manual_seed(8);
  Model m;
  m.config = small_config();
  m.geometry = GeometryNetwork(m.config.model);
  if (texture) m.texture = TextureNetwork(m.config.model);
  m.coat_names = {"a", "b"};
  m.provenance = {{"geometry", {{"epoch", 3}}}};
  return m;
}

std::string refusal(const std::filesystem::path& file) {
  try {
    load_model(file);
  } catch (const InputError& e) {
    return e.what();
  }
  return "";
}

}  // namespace

TEST_CASE("a model comes back from its file, whole or as half floats") {
  const TemporaryFile folder("x", "");
  const std::filesystem::path file = folder.path.parent_path() / "m.netepu";
  for (const bool texture : {false, true})
    for (const bool half : {false, true}) {
      const Model m = small_model(texture);
      save_model(file, m, half);
      const Model back = load_model(file);
      CHECK(to_json(back.config) == to_json(m.config));
      CHECK(back.coat_names == m.coat_names);
      CHECK(back.provenance == m.provenance);
      CHECK(back.texture.is_empty() == !texture);
      CHECK_FALSE(back.geometry->is_training());
      const auto ours = m.geometry->named_parameters(), theirs = back.geometry->named_parameters();
      REQUIRE(ours.size() == theirs.size());
      for (const auto& p : ours) {
        const torch::Tensor expected = half ? p.value().to(torch::kHalf).to(torch::kFloat) : p.value();
        CHECK(torch::equal(theirs[p.key()], expected));
      }
    }
}

TEST_CASE("a model file that is cut short, damaged, of another kind or another configuration is refused in one sentence") {
  const TemporaryFile folder("x", "");
  const std::filesystem::path file = folder.path.parent_path() / "m.netepu";
  save_model(file, small_model(true), false);
  const std::vector<std::uint8_t> whole = read_file(file);
  const auto write = [&](std::size_t size) { write_file_atomically(file, whole.data(), size); };
  for (const std::size_t size : {std::size_t{0}, std::size_t{10}, std::size_t{27}, std::size_t{33}, std::size_t{900}, whole.size() / 2, whole.size() - 1}) {
    write(size);
    const std::string said = refusal(file);
    INFO(size << ": " << said);
    CHECK((said.find("cut short") != std::string::npos || said.find("is no model") != std::string::npos));
  }
  std::vector<std::uint8_t> bytes = whole;
  bytes[bytes.size() - 40] ^= 1;
  write_file_atomically(file, bytes.data(), bytes.size());
  CHECK(refusal(file).find("damaged") != std::string::npos);
  write_file_atomically(file, std::string("P6 not a model at all, but long enough to be looked at"));
  CHECK(refusal(file).find("is no model of netepu") != std::string::npos);
  CHECK(refusal(folder.path.parent_path() / "absent").find("absent") != std::string::npos);

  TensorFile other = [&] {
    write(whole.size());
    return read_tensor_file(file);
  }();
  other.header["config"]["model"]["head_width"] = 32;
  write_tensor_file(file, other);
  CHECK(refusal(file).find("does not fit its configuration (tensor '") != std::string::npos);
  other.header["kind"] = "state";
  write_tensor_file(file, other);
  CHECK(refusal(file).find("is a training state, not a model") != std::string::npos);
}
