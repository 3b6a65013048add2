// Encoders at 1024 x 768 on a view as datasets have them: an animal on a fifth of the pixels.
#include <benchmark/benchmark.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <filesystem>

#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/dataset.h"
#include "generator/dataset/encode_view.h"

using namespace moomill;

namespace {

constexpr int width = 1024, height = 768;

// An ellipsoid with bumps: smooth depth and NNOPCS with a silhouette, 19 % of the pixels.
View bumpy_view() {
  View view;
  view.frame = 1;
  view.width = width;
  view.height = height;
  Map silhouette, depth, nnopcs, rgb;
  silhouette.modality = Modality::silhouette;
  silhouette.u = ImageU32(width, height, 1);
  depth.modality = Modality::depth;
  depth.f = ImageF(width, height, 1);
  nnopcs.modality = Modality::nnopcs;
  nnopcs.f = ImageF(width, height, 3);
  rgb.modality = Modality::rgb;
  rgb.coat = 0;
  rgb.f = ImageF(width, height, 4);
  std::uint32_t noise = 1;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const double u = (x + 0.5 - width / 2) / 300.0, v = (y + 0.5 - height / 2) / 160.0, r = u * u + v * v;
      if (r >= 1) continue;
      const double z = std::sqrt(1 - r) + 0.02 * std::sin(40 * u) * std::sin(31 * v);
      silhouette.u.at(x, y) = 255;
      depth.f.at(x, y) = static_cast<float>(7 - 0.4 * z);
      const double point[3] = {0.5 + 0.5 * u, 0.5 + 0.5 * z, 0.5 - 0.5 * v};
      for (int c = 0; c < 3; ++c) {
        nnopcs.f.at(x, y, c) = static_cast<float>(point[c]);
        noise = noise * 1664525u + 1013904223u;
        rgb.f.at(x, y, c) = static_cast<float>(0.3 * z + 0.05 * (noise >> 8) / 16777216.0);
      }
      rgb.f.at(x, y, 3) = 1;
    }
  view.maps = {silhouette, depth, nnopcs, rgb};
  return view;
}

const View& view() {
  static const View made = bumpy_view();
  return made;
}

Manifest manifest() {
  Manifest m;
  m.animals = {"cow"};
  m.coats = {"coat"};
  m.coat_indices = {0};
  for (int f = 1; f <= 1000000; ++f) m.frames.push_back(f);
  for (Modality modality : {Modality::silhouette, Modality::depth, Modality::nnopcs, Modality::rgb})
    m.modalities.add(modality);
  m.cameras.resize(1);
  return m;
}

void encode(benchmark::State& state, Modality modality) {
  Manifest m;
  m.coats = {"coat"};
  const Map& map = *view().find(modality, modality == Modality::rgb ? 0 : -1);
  std::size_t bytes = 0;
  for (auto _ : state) {
    bytes = 0;
    for (const EncodedFile& file : encode_map(m, view(), map)) bytes += file.bytes.size();
  }
  state.counters["bytes"] = static_cast<double>(bytes);
}
BENCHMARK_CAPTURE(encode, jpeg, Modality::rgb)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(encode, silhouette_png, Modality::silhouette)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(encode, depth_exr, Modality::depth)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(encode, nnopcs_exr_and_png, Modality::nnopcs)->Unit(benchmark::kMillisecond);

// Silhouette, depth and NNOPCS of whole views to disk through the writer, on all cores; items are views.
void write_views(benchmark::State& state) {
  namespace fs = std::filesystem;
  const fs::path folder = fs::temp_directory_path() / ("moomill-bench-" + std::to_string(::getpid()));
  fs::remove_all(folder);
  Manifest m = manifest();
  m.modalities = {};
  for (Modality modality : {Modality::silhouette, Modality::depth, Modality::nnopcs}) m.modalities.add(modality);
  m.frames.resize(1);
  DatasetWriter writer(folder, m, hardware_threads());
  int camera = 0;
  constexpr int batch = 8;
  for (auto _ : state) {
    parallel_for(batch, 1, [&](std::size_t i) {
      View one = view();
      one.camera = (camera + static_cast<int>(i)) % 1000;
      one.frame = 1 + (camera + static_cast<int>(i)) / 1000;
      writer.write_view(one);
    });
    camera += batch;
  }
  state.SetItemsProcessed(camera);
  fs::remove_all(folder);
}
BENCHMARK(write_views)->Unit(benchmark::kMillisecond)->UseRealTime();

void decode(benchmark::State& state, Modality modality) {
  namespace fs = std::filesystem;
  Manifest m;
  const fs::path file = fs::temp_directory_path() / ("moomill-bench-" + std::to_string(::getpid()));
  const auto bytes = encode_map(m, view(), *view().find(modality)).front().bytes;
  write_file_atomically(file, bytes.data(), bytes.size());
  for (auto _ : state) {
    if (modality == Modality::silhouette)
      benchmark::DoNotOptimize(decode_png8(file));
    else
      benchmark::DoNotOptimize(decode_exr(file));
  }
  fs::remove(file);
}
BENCHMARK_CAPTURE(decode, silhouette_png, Modality::silhouette)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(decode, nnopcs_exr, Modality::nnopcs)->Unit(benchmark::kMillisecond);

}  // namespace
