#include "neural/codes.h"

#include <fmt/format.h>

#include <cstring>
#include <sstream>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"

namespace moomill {

namespace fs = std::filesystem;
using torch::Tensor;

namespace {

constexpr const char* format_name = "netepu codes 1";

fs::path views_file(const fs::path& file) {
  if (file.extension() != ".npy") input_error("{}: a file of codes ends in .npy; name it so", file.string());
  return fs::path(file).replace_extension(".jsonl");
}

// NumPy's format, version 1.0: magic, version, length of a Python dictionary padded with blanks to 64 bytes, the data.
std::string npy_bytes(const Tensor& values) {
  const Tensor data = values.to(torch::kFloat).contiguous();
  std::string header =
      fmt::format("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}), }}", data.size(0), data.size(1));
  header.append(63 - (10 + header.size()) % 64, ' ');
  header += '\n';
  std::string out("\x93NUMPY\x01\x00", 8);
  out += static_cast<char>(header.size() & 255);
  out += static_cast<char>(header.size() >> 8);
  out += header;
  out.append(reinterpret_cast<const char*>(data.data_ptr<float>()),
             static_cast<std::size_t>(data.numel()) * sizeof(float));
  return out;
}

Tensor read_npy(const fs::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  const auto refuse = [&](const std::string& why) {
    input_error("{}: {}; write it anew with `netepu embed`", file.string(), why);
  };
  if (bytes.size() < 10 || std::memcmp(bytes.data(), "\x93NUMPY\x01", 7) != 0) refuse("is no NumPy file of version 1");
  const std::size_t length = bytes[8] + 256u * bytes[9];
  if (bytes.size() < 10 + length) refuse("is cut short");
  const std::string header(bytes.begin() + 10, bytes.begin() + 10 + static_cast<std::ptrdiff_t>(length));
  long long rows = -1, columns = -1;
  const std::size_t shape = header.find("'shape': (");
  if (header.find("'<f4'") == std::string::npos || header.find("'fortran_order': False") == std::string::npos ||
      shape == std::string::npos ||
      std::sscanf(header.c_str() + shape, "'shape': (%lld, %lld)", &rows, &columns) != 2 || rows < 0 || columns < 0)
    refuse("is not a row-major float32 matrix");
  const std::size_t data = bytes.size() - 10 - length;
  if (columns == 0 ? data != 0
                   : data % sizeof(float) ||
                         data / sizeof(float) / static_cast<std::size_t>(columns) != static_cast<std::size_t>(rows) ||
                         data / sizeof(float) % static_cast<std::size_t>(columns))
    refuse("does not hold as many numbers as its header says");
  Tensor out = torch::empty({rows, columns});
  std::memcpy(out.data_ptr<float>(), bytes.data() + 10 + length, data);
  return out;
}

}  // namespace

void write_codes(const fs::path& file, const CodeSet& set) {
  check(set.codes.size(0) == static_cast<std::int64_t>(set.views.size()) && set.names.size() == set.views.size(),
        "a view and a name for every code");
  const fs::path views = views_file(file);
  std::string lines = Json{{"format", format_name}, {"codes", set.views.size()}, {"features", set.codes.size(1)},
                           {"model", set.model},    {"dataset", set.dataset},    {"cameras", set.cameras}}
                          .dump() +
                      "\n";
  for (std::size_t i = 0; i < set.views.size(); ++i) {
    const ViewId& v = set.views[i];
    lines += Json{{"frame", v.frame}, {"camera", v.camera}, {"coat", v.coat}, {"name", set.names[i]}}.dump() + "\n";
  }
  write_file_atomically(views, lines);
  write_file_atomically(file, npy_bytes(set.codes));
}

CodeSet read_codes(const fs::path& file) {
  const fs::path views = views_file(file);
  CodeSet set;
  set.codes = read_npy(file);
  if (!torch::isfinite(set.codes).all().item<bool>())
    input_error("{}: a code is not a finite number; write it anew with `netepu embed`", file.string());
  const std::vector<std::uint8_t> bytes = read_file(views);
  std::istringstream lines(std::string(bytes.begin(), bytes.end()));
  std::string line;
  int number = 0;
  try {
    while (std::getline(lines, line)) {
      ++number;
      const Json json = Json::parse(line);
      if (number == 1) {
        if (json.at("format") != format_name)
          input_error("{}: its \"format\" is not \"{}\"; write it anew with `netepu embed`", views.string(),
                      format_name);
        set.model = json.at("model").get<std::string>();
        set.dataset = json.at("dataset").get<std::string>();
        set.cameras = json.at("cameras").get<std::string>();
        continue;
      }
      set.views.push_back({json.at("frame").get<int>(), json.at("camera").get<int>(), json.at("coat").get<int>()});
      set.names.push_back(json.at("name").get<std::string>());
    }
  } catch (const Json::exception& e) {
    input_error("{}, line {}: {}; write it anew with `netepu embed`", views.string(), number, reason_of(e));
  }
  if (static_cast<std::int64_t>(set.views.size()) != set.codes.size(0))
    input_error("{}: names {} views, but {} has {} codes; write both anew with `netepu embed`", views.string(),
                set.views.size(), file.string(), set.codes.size(0));
  return set;
}

CodeSet embed(Model& model, const SampleSource& source, const std::vector<ViewId>& views, const EmbedOptions& options) {
  require_texture(model);
  if (source.coats().empty()) input_error("{}: was opened without coats; name the coats to embed", source.describe());
  CodeSet set;
  std::vector<Tensor> codes;
  std::string matrices;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (options.stop && options.stop()) break;
    const int frame = views[i].frame, camera = views[i].camera;
    std::vector<FullView> coats;
    std::vector<Tensor> pictures;
    for (const int coat : source.coats()) {
      coats.push_back(source.view({frame, camera, coat}));
      pictures.push_back(coats.back().color);
    }
    const FullView& truth = coats[0];
    ViewMaps maps{truth.mask, truth.depth, truth.nnopcs};
    if (!options.true_maps) {
      const PosedAnimal animal = pose_animal(model.geometry, truth.keypoints, fmt::format("frame {}", frame));
      maps = render_maps(model.geometry, view_animal(model.geometry, animal, camera_of(truth)), animal, options.refine,
                         Surface::nnopcs);
    }
    codes.push_back(encode_coats(model, torch::stack(pictures), maps.mask, maps.nnopcs));
    for (std::size_t c = 0; c < coats.size(); ++c) {
      set.views.push_back({frame, camera, source.coats()[c]});
      set.names.push_back(source.coat_names()[c]);
    }
    if (options.progress) options.progress(static_cast<int>(i + 1), static_cast<int>(views.size()));
  }
  if (!views.empty())
    for (const int camera : source.cameras()) {
      const CameraRecord record = camera_of(source.view({views[0].frame, camera, -1}));
      matrices += Json(record.world_to_camera).dump();
    }
  set.codes = codes.empty() ? torch::empty({0, model.config.model.global_features}) : torch::cat(codes);
  set.dataset = source.describe();
  set.cameras = xxh64_hex(matrices.data(), matrices.size());
  return set;
}

}  // namespace moomill
