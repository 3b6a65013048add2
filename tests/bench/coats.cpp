// What a further coat of a herd costs: processor time of light transport for one coat, twelve, a hundred and as many as are asked for, in
// turns. Without baking, which happens once and is dear: 1000 coats take minutes before the first is traced.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <memory>

#include "generator/core/stage_times.h"
#include "scenes/runner.h"

using namespace moomill;

namespace {

// A herd in one pose, 1024 x 768 with 64 samples, coats of 512 x 512.
struct Herd {
  std::unique_ptr<Mill> mill;
  Frame frame;
  std::vector<std::shared_ptr<const Dressed>> batches;
  std::vector<double> seconds;

  explicit Herd(int coats) {
    const auto file = std::filesystem::temp_directory_path() / fmt::format("moomill-herd-{}.toml", coats);
    std::ofstream(file) << fmt::format(
        "seed = 1\nmodalities = [\"rgb\"]\n[[animals]]\nspecies = \"cow\"\ncoats = [{{breed = \"holstein\", count = {}, seed = 7}}]\n"
        "poses = [{{clip = \"walk\", count = 2}}, {{clip = \"graze\", count = 2}}]\n"
        "[render]\nsamples = 64\ncoat_resolution = 512\nmemory_mb = 8000\n", coats);
    mill = std::make_unique<Mill>(read_scene(file));
    std::filesystem::remove(file);
    frame = mill->prepare(1);
    for (int b = 0; b < mill->batches(); ++b) batches.push_back(mill->dress(frame, b));
  }
  void trace() {
    const double begin = process_processor_seconds();
    for (const auto& b : batches) benchmark::DoNotOptimize(mill->trace_coats(frame, frame.cameras.at(13), *b).maps.size());
    seconds.push_back(process_processor_seconds() - begin);
  }
};

void further_coats(benchmark::State& state) {
  const int sizes[4] = {1, 12, 100, static_cast<int>(state.range(0))};
  std::vector<Herd> herds;
  for (const int n : sizes) herds.emplace_back(n);
  herds[0].trace();  // tables are made
  herds[0].seconds.clear();
  for (auto _ : state)
    for (Herd& h : herds) h.trace();
  // Each further coat in units of the first, round by round.
  const auto ratio = [&](int from, int to) {
    std::vector<double> r;
    for (std::size_t i = 0; i < herds[0].seconds.size(); ++i)
      r.push_back((herds[to].seconds[i] - herds[from].seconds[i]) / ((sizes[to] - sizes[from]) * herds[0].seconds[i]));
    std::sort(r.begin(), r.end());
    return r[r.size() / 2];
  };
  state.counters["further_1_12"] = ratio(0, 1);
  state.counters["further_12_100"] = ratio(1, 2);
  state.counters["further_12_all"] = ratio(1, 3);
  for (Herd& h : herds) std::sort(h.seconds.begin(), h.seconds.end());
  for (int i = 0; i < 4; ++i) state.counters[fmt::format("s_{:04}", sizes[i])] = herds[i].seconds[herds[i].seconds.size() / 2];
}
BENCHMARK(further_coats)->Arg(256)->Iterations(3)->Unit(benchmark::kMillisecond);
BENCHMARK(further_coats)->Arg(1000)->Iterations(1)->Unit(benchmark::kMillisecond);  // minutes

}  // namespace
