#include "validate/studies/converge.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "generator/core/stage_times.h"
#include "scenes/runner.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

struct Times {
  double seconds = 0, core_seconds = 0;
};

// Elapsed time, and processor time of all threads of this process.
class Stopwatch {
 public:
  Times read() const {
    return {std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count(), process_processor_seconds() - processor_start_};
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  double processor_start_ = process_processor_seconds();
};

// One view in every coat, and what it took, per coat.
struct Pictures {
  double samples = 0;  // a pixel
  std::map<int, ImageF> of_coat;
  std::map<int, Times> times;
};

// What measures one frame: the frame in all batches of coats, and the preparation's share of a picture.
struct Prepared {
  Frame frame;
  std::vector<std::shared_ptr<const Dressed>> batches;
  Times share;  // of one picture
};

Prepared prepare(const Mill& mill, int number, int cameras_per_frame) {
  Prepared p;
  Stopwatch watch;
  p.frame = mill.prepare(number);
  const Times geometry = watch.read();
  std::size_t coats = 0;
  for (int b = 0; b < mill.batches(); ++b) coats += mill.dress(p.frame, b)->coats.size();  // bakes, which a dataset does once
  watch = {};
  for (int b = 0; b < mill.batches(); ++b) p.batches.push_back(mill.dress(p.frame, b));
  const Times dressing = watch.read();
  const double pictures = static_cast<double>(std::max(1, cameras_per_frame)) * static_cast<double>(std::max<std::size_t>(1, coats));
  p.share = {(geometry.seconds + dressing.seconds) / pictures, (geometry.core_seconds + dressing.core_seconds) / pictures};
  return p;
}

Pictures render(const Mill& mill, const Prepared& prepared, const CameraRecord& camera, const Resampling& resampling) {
  Pictures out;
  for (const auto& batch : prepared.batches) {
    const Stopwatch watch;
    View view = mill.trace_coats(prepared.frame, camera, *batch, resampling);
    const Times all = watch.read();
    const auto coats = static_cast<double>(batch->coats.size());
    out.samples = view.samples;
    for (Map& map : view.maps) {
      out.times[map.coat] = {all.seconds / coats + prepared.share.seconds, all.core_seconds / coats + prepared.share.core_seconds};
      out.of_coat[map.coat] = std::move(map.f);
    }
  }
  return out;
}

// Never 0, which stands for the samples of the dataset; the reference's halves are the repetitions 0 and 1 of samples 0.
std::uint64_t repetition_key(int samples, int repetition) {
  const std::uint64_t key =
      hash_identity({hash_text("converge"), static_cast<std::uint64_t>(samples), static_cast<std::uint64_t>(repetition)});
  return key != 0 ? key : 1;
}

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream in(line);
  for (std::string cell; std::getline(in, cell, ',');) cells.push_back(cell);
  return cells;
}

}  // namespace

std::string convergence_csv(const std::vector<ConvergenceRow>& rows) {
  std::string out = std::string(convergence_header) + "\n";
  for (const ConvergenceRow& r : rows)
    out += fmt::format("{},{},{},{},{},{:.6g},{:.6g},{:.6g},{:.6g},{:.6g}\n", r.renderer, r.frame, r.camera, r.coat, r.samples, r.seconds,
                       r.core_seconds, r.error.mse, r.error.relative_mse, r.error.ciede2000);
  return out;
}

std::vector<ConvergenceRow> read_convergence(const fs::path& file_or_folder) {
  const fs::path file = fs::is_directory(file_or_folder) ? file_or_folder / convergence_file : file_or_folder;
  std::ifstream in(file);
  if (!in) input_error("{}: cannot be read; name a {} or a folder that holds one, as `moomill converge` writes it", file.string(), convergence_file);
  std::string line;
  const auto chomp = [&] {
    if (!line.empty() && line.back() == '\r') line.pop_back();
  };
  std::getline(in, line);
  chomp();
  if (line != convergence_header) input_error("{}: line 1 is not the header of a convergence table; it must be {}", file.string(), convergence_header);
  std::vector<ConvergenceRow> rows;
  for (int number = 2; std::getline(in, line); ++number) {
    chomp();
    if (line.empty()) continue;
    const std::vector<std::string> cells = split(line);
    std::size_t at = 0;
    try {
      if (cells.size() != 10) throw std::invalid_argument("columns");
      const auto count = [&](std::size_t i) {
        const int v = std::stoi(cells[at = i], &at);
        if (at != cells[i].size() || v < 0) throw std::invalid_argument("count");
        return v;
      };
      const auto measure = [&](std::size_t i) {
        const double v = std::stod(cells[i], &at);
        if (at != cells[i].size() || !std::isfinite(v) || v < 0) throw std::invalid_argument("measure");
        return v;
      };
      ConvergenceRow r;
      r.renderer = cells[0];
      r.frame = count(1), r.camera = count(2), r.coat = count(3), r.samples = count(4);
      r.seconds = measure(5), r.core_seconds = measure(6);
      r.error = {measure(7), measure(8), measure(9)};
      if (r.renderer.empty() || r.samples < 1) throw std::invalid_argument("renderer or samples");
      rows.push_back(std::move(r));
    } catch (const std::logic_error&) {  // what std::stoi and std::stod throw, too
      input_error("{}: line {} is no row of ten cells ({}); a name, four whole numbers, five finite numbers from 0 on", file.string(), number,
                  convergence_header);
    }
  }
  if (rows.empty()) input_error("{}: holds no measurements; run the study that writes it again", file.string());
  return rows;
}

Convergence measure_convergence(const SceneSpec& scene, const ConvergeOptions& options) {
  SceneSpec spec = scene;
  spec.modalities = {};
  spec.modalities.add(Modality::rgb);
  spec.modalities.add(Modality::silhouette);
  const int threads = options.threads > 0 ? options.threads : hardware_threads();
  tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
  const int reference_samples = options.reference_samples > 0 ? options.reference_samples : 16 * options.max_samples;
  std::vector<Resampling> measured;
  for (const double e : options.target_errors) measured.push_back({0, e});
  if (measured.empty())
    for (int n = options.min_samples; n <= options.max_samples; n *= 2) measured.push_back({n});

  const Mill mill(spec);
  std::size_t total = 0, done = 0;
  std::size_t per_view = reference_samples;
  for (const Resampling& m : measured) per_view += static_cast<std::size_t>(options.repetitions) * m.samples;
  const auto tell = [&](int more, const std::string& stage) {
    done += more;
    if (options.progress) options.progress(done, total, stage);
    if (options.stop && options.stop->load()) run_error("stopped before the study was done; run the same command again, it starts anew");
  };

  Convergence out;
  std::map<double, std::vector<std::size_t>, std::greater<>> of_target;  // rows
  for (const int number : spec.frames) {
    const Prepared prepared = prepare(mill, number, options.cameras_per_frame);
    total = spec.frames.size() * prepared.frame.cameras.size() * per_view;
    for (const CameraRecord& camera : prepared.frame.cameras) {
      const View labels = mill.trace_labels(prepared.frame, camera);
      const Map* silhouette = labels.find(Modality::silhouette);
      check(silhouette != nullptr, "a scene with animals has a silhouette");
      const ImageU32& mask = silhouette->u;
      if (std::none_of(mask.data.begin(), mask.data.end(), [](std::uint32_t v) { return v != 0; }))
        input_error("{}: no animal is in frame {} of camera {}; choose another camera", spec.file, number, camera.id);

      tell(0, fmt::format("reference of camera {}", camera.id));
      const Pictures a = render(mill, prepared, camera, {(reference_samples + 1) / 2, 0, repetition_key(0, 0), true});
      tell(reference_samples / 2, "");
      const Pictures b = render(mill, prepared, camera, {(reference_samples + 1) / 2, 0, repetition_key(0, 1), true});
      std::map<int, Reference> references;
      for (const auto& [coat, picture] : a.of_coat) {
        references[coat] = join_halves(picture, b.of_coat.at(coat), mask);
        out.references.push_back({number, camera.id, coat, 2 * ((reference_samples + 1) / 2), references[coat].mse});
      }
      tell(reference_samples - reference_samples / 2, fmt::format("camera {}", camera.id));

      for (int r = 0; r < options.repetitions; ++r)
        for (const Resampling& asked : measured) {
          Resampling again = asked;
          again.repetition = repetition_key(asked.samples > 0 ? asked.samples : -static_cast<int>(1e6 * asked.target_error), r);
          const Pictures pictures = render(mill, prepared, camera, again);
          const int n = asked.samples > 0 ? asked.samples : std::max(1, static_cast<int>(std::lround(pictures.samples)));
          std::vector<int> coats;
          for (const auto& [coat, picture] : pictures.of_coat) coats.push_back(coat);
          std::vector<PictureError> errors(coats.size());
          parallel_for(coats.size(), 1, [&](std::size_t i) { errors[i] = picture_error(pictures.of_coat.at(coats[i]), references.at(coats[i]).picture, mask); });
          for (std::size_t i = 0; i < coats.size(); ++i) {
            const Times& t = pictures.times.at(coats[i]);
            if (asked.target_error > 0) of_target[asked.target_error].push_back(out.rows.size());
            out.rows.push_back({"moomill", number, camera.id, coats[i], n, t.seconds, t.core_seconds, errors[i]});
          }
          tell(asked.samples, fmt::format("camera {}", camera.id));
        }
    }
  }
  // Rows of one target have one number of samples, their mean, and no two targets the same: points of a curve.
  int last = 0;
  for (const auto& [target, rows] : of_target) {
    double sum = 0;
    for (const std::size_t i : rows) sum += out.rows[i].samples;
    last = std::max(last + 1, static_cast<int>(std::lround(sum / static_cast<double>(rows.size()))));
    for (const std::size_t i : rows) out.rows[i].samples = last;
  }
  return out;
}

}  // namespace moomill
