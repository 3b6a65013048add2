#include "scenes/generate.h"

#include <tbb/global_control.h>
#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <chrono>
#include <mutex>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "scenes/runner.h"

namespace moomill {
namespace {

std::vector<int> shard_of(const std::vector<int>& frames, int shard, int shards) {
  std::vector<int> mine;
  for (std::size_t i = 0; i < frames.size(); ++i)
    if (static_cast<int>(i % shards) == shard) mine.push_back(frames[i]);
  return mine;
}

}  // namespace

void require_poses(const SceneSpec& scene, const Mill& mill) {
  for (int a = 0; a < mill.animals(); ++a) {
    const AnimalSpec& spec = scene.animals[a];
    std::vector<const PoseSource*> seen;  // one pose of a clip or a sampler stands for all; every pose of a file is its own
    for (const int frame : scene.frames) {
      int index = pose_count(spec, mill.species(a)) == 1 ? 0 : frame - scene.first_frame;
      const PoseSource* source = nullptr;
      for (const PoseSource& p : spec.poses) {
        int count = 0;
        if (const auto* file = std::get_if<PoseFile>(&p)) count = file->poses ? static_cast<int>(file->poses->size()) : 0;
        if (const auto* clip = std::get_if<ClipFrames>(&p)) count = clip->count;
        if (const auto* sampler = std::get_if<PoseSampler>(&p)) count = sampler->count;
        if (index < count) {
          source = &p;
          break;
        }
        index -= count;
      }
      if (source && !std::holds_alternative<PoseFile>(*source)) {
        if (std::find(seen.begin(), seen.end(), source) != seen.end()) continue;
        seen.push_back(source);
      }
      pose_of_frame(scene, spec, mill.species(a), frame - scene.first_frame);
    }
  }
}

void generate(const SceneSpec& scene, const GenerateOptions& options) {
  if (options.shards < 1 || options.shard < 0 || options.shard >= options.shards)
    input_error("--shard {}/{}: the first number counts from 0 and is below the second", options.shard, options.shards);
  const int threads = options.threads > 0 ? options.threads : hardware_threads();
  tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
  const auto start = std::chrono::steady_clock::now();
  std::mutex progress_mutex;
  Progress progress;
  auto tell = [&](const char* stage, std::size_t more) {
    std::lock_guard lock(progress_mutex);
    progress.views_done += more;
    progress.stage = stage;
    progress.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (options.progress) options.progress(progress);
  };
  tell("loading", 0);

  const Mill mill(scene);
  require_poses(scene, mill);  // before anything is written, and so are the first frame's lights made and its map of the sky read
  if (mill.batches() > 0) {
    const Frame first = mill.prepare(scene.frames.front());
    mill.lights(first, first.cameras.front());
  }
  Manifest manifest = mill.manifest();
  manifest.held_frames = shard_of(manifest.frames, options.shard, options.shards);
  DatasetWriter writer(options.out, manifest, threads);
  if (writer.is_complete()) return;
  for (int a = 0; a < mill.animals(); ++a)
    writer.write_rig(a, [&](const std::filesystem::path& file) { write_glb(mill.species(a).rig, file); });

  std::vector<int> frames;
  for (int f : manifest.held_frames)
    if (!writer.is_done(f)) frames.push_back(f);
  progress.views_total = frames.size() * manifest.cameras.size() * std::max<std::size_t>(1, manifest.coat_indices.size());
  tell("rendering", 0);

  // Frames in order into the pipeline; preparing overlaps with tracing and encoding of the frame before.
  std::size_t next = 0;
  std::atomic<std::size_t> frames_done{0};
  bool stopped = false;
  tbb::parallel_pipeline(
      2, tbb::make_filter<void, int>(tbb::filter_mode::serial_in_order,
                                     [&](tbb::flow_control& flow) {
                                       if (options.stop && options.stop->load()) stopped = true;
                                       if (stopped || next == frames.size()) {
                                         flow.stop();
                                         return 0;
                                       }
                                       return frames[next++];
                                     }) &
             tbb::make_filter<int, std::shared_ptr<Frame>>(
                 tbb::filter_mode::parallel, [&](int number) { return std::make_shared<Frame>(mill.prepare(number)); }) &
             tbb::make_filter<std::shared_ptr<Frame>, void>(tbb::filter_mode::parallel, [&](const std::shared_ptr<Frame>& frame) {
               // A stop takes effect at the next view: the frame stays unfinished, and a rerun makes it anew.
               const auto stopping = [&] { return options.stop && options.stop->load(); };
               std::atomic<bool> whole{true};
               const auto for_cameras = [&](const auto& write) {
                 parallel_for(frame->cameras.size(), 1, [&](std::size_t c) {
                   if (stopping())
                     whole = false;
                   else
                     write(frame->cameras[c]);
                 });
               };
               // Labels once, with the first batch of coats; the others batch by batch, so that only one is in memory.
               std::shared_ptr<const Dressed> dressed = mill.batches() > 0 ? mill.dress(*frame, 0) : nullptr;
               for_cameras([&](const CameraRecord& camera) {
                 writer.write_view(mill.trace_labels(*frame, camera));
                 if (dressed) writer.write_pictures(mill.trace_coats(*frame, camera, *dressed));
                 tell("rendering", dressed ? dressed->coats.size() : std::max<std::size_t>(1, manifest.coat_indices.size()));
               });
               for (int b = 1; b < mill.batches() && whole; ++b) {
                 dressed.reset();
                 dressed = mill.dress(*frame, b);
                 for_cameras([&](const CameraRecord& camera) {
                   writer.write_pictures(mill.trace_coats(*frame, camera, *dressed));
                   tell("rendering", dressed->coats.size());
                 });
               }
               if (!whole) return;
               writer.finish_frame(mill.record(*frame));
               ++frames_done;
             }));
  if (frames_done < frames.size())
    run_error("stopped after {} of {} frames; run the same command again to continue",
              manifest.held_frames.size() - (frames.size() - frames_done), manifest.held_frames.size());
  tell("finishing", 0);
  writer.finish();
}

void render_view(const SceneSpec& scene, int frame, int camera, int coat, const std::filesystem::path& exr) {
  Overrides only;
  only.first_frame = only.last_frame = frame;
  only.cameras = {camera};
  only.coats = {coat};
  SceneSpec spec = scene;
  apply_overrides(spec, only);
  const Mill mill(spec);
  const Frame prepared = mill.prepare(frame);
  const View view = mill.trace(prepared, prepared.cameras.at(0));

  std::vector<ExrChannel> channels;
  for (const Map& map : view.maps) {
    const ModalityRow& r = row(map.modality);
    const std::string layer = map.animal >= 0 ? fmt::format("{}{}", r.name, map.animal) : r.name;
    static constexpr const char* rgba[] = {"R", "G", "B", "A"};
    static constexpr const char* xyz[] = {"X", "Y", "Z"};
    if (!map.f.empty())
      for (int c = 0; c < map.f.channels; ++c) {
        std::string name;
        if (map.modality == Modality::rgb)
          name = rgba[c];  // the beauty layer has plain names, so that every viewer shows it
        else if (map.f.channels == 1)
          name = layer + (map.modality == Modality::depth ? ".Z" : ".Y");
        else if (map.f.channels == 2)
          name = layer + (c == 0 ? ".U" : ".V");
        else
          name = layer + "." + xyz[c];
        channels.push_back({name, map.f.data.data() + c, nullptr, map.f.channels});
      }
    if (!map.u.empty()) channels.push_back({layer + ".id", nullptr, map.u.data.data(), 1});
  }
  if (channels.empty()) input_error("{}: no modality of this scene has pixels; add one to modalities", spec.file);
  const auto bytes = encode_exr(view.width, view.height, channels);
  write_file_atomically(exr, bytes.data(), bytes.size());
}

}  // namespace moomill
