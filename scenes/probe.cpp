// What generate() takes, measured on a few views and carried over to all.
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/stage_times.h"
#include "generator/dataset/codecs.h"
#include "scenes/appearance.h"
#include "scenes/generate.h"
#include "scenes/runner.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr double golden = 0.6180339887498949;
constexpr double seconds_per_texel = 2.7e-7;  // of a coat, to choose by how much a coat is baked smaller

// Processor time of the whole program and of this thread. Of work that this thread starts and helps with, its own share is what
// would elapse on a machine with nothing else to do.
struct Spent {
  double processor = 0, elapsed = 0;
};
template <class Body>
Spent measure(const Body& body) {
  const double p = process_processor_seconds(), t = thread_processor_seconds();
  body();
  return {process_processor_seconds() - p, thread_processor_seconds() - t};
}

double stages(const StageTimes& times, const std::string& beginning) {
  double sum = 0;
  for (const auto& [name, seconds] : times.seconds())
    if (name.rfind(beginning, 0) == 0) sum += seconds;
  return sum;
}

struct TemporaryFolder {
  fs::path path = fs::temp_directory_path() / fmt::format("moomill-probe-{}", ::getpid());
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
};

// Baking of all coats of the scene. Loading (`out.start`) has made those of the first batch, maybe smaller than the scene's; what that
// took is taken out of it.
void measure_baking(const SceneSpec& scene, const Mill& mill, const BatchPlan& batch, const StageTimes& times, int threads, ProbeReport& out) {
  const double n = static_cast<double>(mill.spec().coat_indices.size());
  const double all = static_cast<double>(scene.coat_indices.size()), at_once = std::min(n, static_cast<double>(threads));
  const double kept = std::min(all, static_cast<double>(batch.kept) * batch.coats);
  const double bakes = kept + (all - kept) * static_cast<double>(scene.frames.size());
  const double hide = stages(times, "hide") + stages(times, "bake finish"), coats = stages(times, "bake coat");
  ProbeReport::Cost fixed{hide, hide};
  double each = coats / n;
  out.start.processor -= hide + coats;
  out.start.elapsed -= hide + coats / at_once;
  if (mill.spec().render.coat_resolution != scene.render.coat_resolution || (coats == 0 && all > n)) {
    // One coat at full size, for hide, finish and what else all share; and all once more, smaller still: by the growth from the one size to
    // the other. (A coat baked alone says less: side by side they share caches and take up to twice the processor time.)
    std::vector<const Species*> species;
    for (int a = 0; a < mill.animals(); ++a) species.push_back(&mill.species(a));
    StageCounts counts;
    SceneSpec one = scene;
    one.coat_indices.resize(1);
    const Spent whole = measure([&] { const Wardrobe wardrobe(one, species, true, counts); });
    const double alone = stages(times, "bake coat") - coats;
    fixed = {std::max(0.0, whole.processor - alone), std::max(0.0, whole.elapsed - alone)};
    if (coats > 0) {
      SceneSpec smaller = mill.spec();
      smaller.render.coat_resolution /= 2;
      { const Wardrobe wardrobe(smaller, species, true, counts); }
      const double half = stages(times, "bake coat") - coats - alone;
      const double growth = (std::pow(static_cast<double>(scene.render.coat_resolution) / mill.spec().render.coat_resolution, 2) - 1) / 0.75;
      each = (coats + growth * std::max(0.0, coats - half)) / n;
    } else {
      each = fixed.processor / n;  // pictures to read, which no stage tells
    }
  }
  out.baking = {fixed.processor + bakes * each, fixed.elapsed + bakes * each / std::min<double>(threads, std::min<double>(all, batch.coats))};
}

}  // namespace

ProbeReport probe(const SceneSpec& scene, double seconds) {
  check(seconds > 0, "a probe of no time");
  const int threads = hardware_threads();
  const StageTimes times;
  const TemporaryFolder folder;
  const bool light = scene.modalities.has(Modality::rgb);
  ProbeReport out;

  // Batches of coats cost alike: one is enough. Where they are many they are baked smaller.
  SceneSpec spec = scene;
  const BatchPlan batch = light ? plan_batches(scene) : BatchPlan{1, 1, 0};
  if (light) {
    if (static_cast<int>(spec.coat_indices.size()) > batch.coats) spec.coat_indices.resize(batch.coats);
    const double n = static_cast<double>(spec.coat_indices.size() * spec.animals.size());
    while (spec.render.coat_resolution > 256 && n * std::pow(spec.render.coat_resolution, 2) * seconds_per_texel > 0.2 * seconds)
      spec.render.coat_resolution /= 2;
    spec.render.memory_mb = std::max(spec.render.memory_mb, 1.01 * 8e-6 * static_cast<double>(batch.coats) *
        std::max(3.0 * std::pow(spec.render.coat_resolution, 2) * static_cast<double>(spec.animals.size()),
                 16.0 * spec.cameras.width * spec.cameras.height));  // still one batch
    spec.resolved = scene_to_json(spec);
  }
  std::unique_ptr<Mill> loaded;
  std::unique_ptr<DatasetWriter> writer;
  const Spent start = measure([&] {
    loaded = std::make_unique<Mill>(spec);
    require_poses(scene, *loaded);
    writer = std::make_unique<DatasetWriter>(folder.path, loaded->manifest(), threads);
    for (int a = 0; a < loaded->animals(); ++a) writer->write_rig(a, [&](const fs::path& file) { write_glb(loaded->species(a).rig, file); });
  });
  const Mill& mill = *loaded;
  out.start = {start.processor, start.elapsed};
  if (light) measure_baking(scene, mill, batch, times, threads, out);
  const double begin = process_processor_seconds();
  const auto spent = [&] { return process_processor_seconds() - begin; };

  const bool chosen_by_error = light && scene.render.target_error > 0;
  const int samples = chosen_by_error ? 64 : scene.render.samples;  // at most, in the views measured
  int used = samples;                                               // per pixel, in them
  double at_zero = 0, per_sample = 0;  // processor seconds of light in one view
  const double batches = light ? std::ceil(static_cast<double>(scene.coat_indices.size()) / batch.coats) : 0;
  double labels = 0, lit = 0, encoded = 0, pilots = 0, frame_time = 0, pixels_measured = 0, pixels_all = 0;
  double wanted_samples = 0;  // that the target error comes to, times the view's pixels, over the views measured
  std::size_t pictures_all = 0, frames = 0;

  // Steps of about the golden ratio, without a common factor, so that every frame comes once.
  std::size_t stride = std::max<std::size_t>(1, std::llround(golden * static_cast<double>(scene.frames.size())));
  while (std::gcd(stride, scene.frames.size()) != 1) ++stride;

  for (std::size_t round = 0; round < scene.frames.size() && (round == 0 || spent() < seconds); ++round) {
    // Frames and cameras spread evenly however many there come to be.
    const std::size_t at = (scene.frames.size() / 2 + round * stride) % scene.frames.size();
    Frame frame;
    frame_time += measure([&] {
      frame = mill.prepare(scene.frames[at]);
      mill.record(frame);
    }).processor;
    ++frames;
    const std::size_t cameras = frame.cameras.size();
    std::shared_ptr<const Dressed> dressed;
    if (light) frame_time += batches * measure([&] { dressed = mill.dress(frame, 0); }).processor;  // and light held on the surface, where asked for
    if (light && round == 0) {
      const auto trace = [&](int s) { return measure([&] { mill.trace_coats(frame, frame.cameras[0], *dressed, {s, 0, 1}); }).processor; };
      const double first = trace(1), again = trace(1);  // the first also reads the environment map
      out.start.processor += std::max(0.0, first - again);
      out.start.elapsed += std::max(0.0, first - again);
      const int few = std::min(samples, 8), more = std::min(samples, 16);  // samples go eight at a time
      const double a = few == 1 ? again : trace(few), b = more > few ? trace(more) : a;
      per_sample = more > few ? std::max(0.0, (b - a) / (more - few)) : a / few;
      at_zero = std::max(0.0, a - few * per_sample);
      // At least eight views must fit; samples come in eights.
      const double share = 0.6 * seconds / 8;
      if (at_zero + samples * per_sample > share && samples > 8)
        used = std::clamp(static_cast<int>((share - at_zero) / std::max(per_sample, 1e-9)) / 8 * 8, 8, samples);
    }
    std::vector<std::size_t> chosen;
    const std::size_t wanted = std::min<std::size_t>(cameras, 2 * static_cast<std::size_t>(std::max(2, threads)));
    const double offset = std::fmod(golden * static_cast<double>(round), 1.0) * static_cast<double>(cameras) / static_cast<double>(wanted);
    for (std::size_t k = 0; k < wanted; ++k)
      chosen.push_back(static_cast<std::size_t>(offset + static_cast<double>(k * cameras) / static_cast<double>(wanted)) % cameras);

    labels += measure([&] {
      parallel_for(wanted, 1, [&](std::size_t k) { writer->write_view(mill.trace_labels(frame, frame.cameras[chosen[k]])); });
    }).processor;
    if (light) {
      const double before_pictures = stages(times, "encode");
      const double both = measure([&] {
        parallel_for(wanted, 1, [&](std::size_t k) {
          writer->write_pictures(mill.trace_coats(frame, frame.cameras[chosen[k]], *dressed, {used, 0}));
        });
      }).processor;
      const double encoding = stages(times, "encode") - before_pictures;
      encoded += encoding;
      lit += both - encoding;
      std::vector<double> pixels(cameras);
      parallel_for(cameras, 1, [&](std::size_t c) { pixels[c] = static_cast<double>(mill.lit_pixels(frame, frame.cameras[c]).count()); });
      pixels_all += std::accumulate(pixels.begin(), pixels.end(), 0.0);
      pictures_all += cameras;
      for (const std::size_t c : chosen) pixels_measured += pixels[c];
      if (chosen_by_error) {
        std::vector<double> wants(wanted);
        pilots += measure([&] {
          parallel_for(wanted, 1, [&](std::size_t k) { wants[k] = mill.chosen_samples(frame, frame.cameras[chosen[k]], *dressed); });
        }).processor;
        for (std::size_t k = 0; k < wanted; ++k) wanted_samples += wants[k] * pixels[chosen[k]];
      }
    }
    out.views += wanted;
  }
  out.samples = used;
  const double views = static_cast<double>(out.views);
  out.frame = frame_time / static_cast<double>(frames);
  out.labels = labels / views;
  if (light) {
    out.wanted_samples = chosen_by_error ? wanted_samples / std::max(1.0, pixels_measured) : samples;
    out.light = lit / views * (at_zero + out.wanted_samples * per_sample) / std::max(1e-9, at_zero + used * per_sample);
    out.light = batches * (out.light + pilots / views);
    // Light goes with the pixels that may see an animal, and those are counted in all cameras.
    if (pixels_measured > 0) out.light *= pixels_all / static_cast<double>(pictures_all) / (pixels_measured / views);
    out.encoding = encoded / views / static_cast<double>(spec.coat_indices.size()) * static_cast<double>(scene.coat_indices.size());
  }
  const double n = static_cast<double>(scene.frames.size()), pictures = n * static_cast<double>(cameras_of_frame(scene, scene.frames[0]).size());
  const double parallel = n * out.frame + pictures * (out.labels + out.light + out.encoding);
  out.processor_seconds = out.start.processor + out.baking.processor + parallel;
  out.seconds = out.start.elapsed + out.baking.elapsed + parallel / threads;
  out.took = spent();
  return out;
}

}  // namespace moomill
