#include "validate/studies/leave_out.h"

#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "generator/core/error.h"
#include "generator/core/stage_times.h"
#include "generator/core/words.h"
#include "scenes/generate.h"
#include "validate/studies/error_measures.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr double least_ratio = 0.9;
// A bound that leaves out a tenth can be held against figures that are known to a tenth. Fewer pairs say too little of the scatter: of
// three, the median deviation is half as large as it should be every few runs.
constexpr double most_uncertainty = 0.1;  // of the stages' time
constexpr std::size_t fewest_pairs = 5;

// What the child process does: the whole of `generate` on one thread, told to the parent as JSON.
std::string generate_and_tell(const SceneSpec& scene, const fs::path& folder) {
  try {
    const StageTimes times;
    GenerateOptions options;
    options.out = folder;
    options.threads = 1;
    generate(scene, options);
    Json out{{"stages", times.seconds()}, {"seconds", process_processor_seconds()}};
    return out.dump();
  } catch (const std::exception& e) {
    return Json{{"error", e.what()}}.dump();
  }
}

double stage_seconds(const Run& run, const std::vector<std::string>& stages) {
  double sum = 0;
  for (const auto& [name, seconds] : run.stages)
    for (const std::string& wanted : stages) {
      const bool open = wanted.back() == '*';
      const std::string stem = wanted.substr(0, wanted.size() - open);
      if (open ? name.rfind(stem, 0) == 0 : name == stem) {
        sum += seconds;
        break;
      }
    }
  return sum;
}

}  // namespace

std::vector<Variant> variants_of(const SceneSpec& scene) {
  std::vector<Variant> out;
  const auto add = [&](const std::string& part, std::vector<std::string> stages, const auto& change) {
    Variant v{part, scene, std::move(stages)};
    change(v.scene);
    v.scene.resolved = scene_to_json(v.scene);
    out.push_back(std::move(v));
  };
  int modalities = 0;
  for (const ModalityRow& r : modality_table()) modalities += scene.modalities.has(r.id);
  if (modalities > 1)
    for (const ModalityRow& r : modality_table()) {
      if (!scene.modalities.has(r.id)) continue;
      const std::string name = r.name;
      std::vector<std::string> stages{"encode " + name, "labels " + name, name};
      if (r.needs_light) stages = {"encode " + name + "*", "light", "environment", "hide", "bake*"};
      add("modality " + name, std::move(stages), [&](SceneSpec& s) { s.modalities.bits &= ~(1u << static_cast<int>(r.id)); });
    }
  if (!scene.modalities.has(Modality::rgb)) return out;
  // A path samples one light at each of its points, however many there are; so a light has a stage of its own only where a file
  // is read for it.
  for (std::size_t i = 0; i < scene.light.suns.size(); ++i)
    add(fmt::format("light suns[{}]", i), {}, [&](SceneSpec& s) { s.light.suns.erase(s.light.suns.begin() + i); });
  for (std::size_t i = 0; i < scene.light.rectangles.size(); ++i)
    add(fmt::format("light rectangles[{}]", i), {}, [&](SceneSpec& s) { s.light.rectangles.erase(s.light.rectangles.begin() + i); });
  add("light environment", {"environment"}, [&](SceneSpec& s) {
    s.light.environment_file.reset();
    s.light.environment_color = constant_vector(dvec3(0));
  });
  if (scene.coat_indices.size() > 1)
    for (std::size_t i = 0; i < scene.coat_indices.size(); ++i) {
      const int coat = scene.coat_indices[i];
      const std::string file = scene.animals[0].coats.at(coat);
      const std::string name = fs::path(file).stem().string();
      add(fmt::format("coat {}", coat), {"bake coat " + file, "bake coat " + name, fmt::format("encode rgb of coat {}", coat)},
          [&](SceneSpec& s) { s.coat_indices.erase(s.coat_indices.begin() + i); });
    }
  return out;
}

Run run_alone(const SceneSpec& scene, const fs::path& folder) {
  int ends[2];
  if (::pipe(ends) != 0) run_error("a pipe to a run cannot be made: {}", std::strerror(errno));
  std::fflush(nullptr);
  const pid_t child = ::fork();
  if (child < 0) {
    ::close(ends[0]), ::close(ends[1]);
    run_error("a run cannot be started: {}", std::strerror(errno));
  }
  if (child == 0) {
    ::close(ends[0]);
    const std::string text = generate_and_tell(scene, folder);
    for (std::size_t at = 0; at < text.size();) {
      const ssize_t n = ::write(ends[1], text.data() + at, text.size() - at);
      if (n <= 0) break;
      at += static_cast<std::size_t>(n);
    }
    ::_exit(0);  // without the parent's destructors
  }
  ::close(ends[1]);
  std::string text;
  char buffer[4096];
  for (;;) {
    const ssize_t n = ::read(ends[0], buffer, sizeof buffer);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    text.append(buffer, static_cast<std::size_t>(n));
  }
  ::close(ends[0]);
  int status = 0;
  rusage usage{};
  while (::wait4(child, &status, 0, &usage) < 0 && errno == EINTR) {
  }
  std::error_code ignored;
  fs::remove_all(folder, ignored);
  const Json told = Json::parse(text, nullptr, false);
  if (told.is_discarded() || !told.is_object()) run_error("a run of {} ended before it was done", scene.file);
  if (told.contains("error")) run_error("a run of {} failed: {}", scene.file, told["error"].get<std::string>());
  Run run;
  run.stages = told["stages"].get<std::map<std::string, double>>();
  run.seconds = told["seconds"].get<double>() - stage_seconds(run, {"species"});
  run.peak_megabytes = static_cast<double>(usage.ru_maxrss) * 1024e-6;  // Linux tells KiB
  return run;
}

std::vector<LeaveOut> measure_leave_out(const SceneSpec& scene, const LeaveOutOptions& options) {
  std::vector<LeaveOut> out;
  std::vector<Variant> all = variants_of(scene);
  for (const std::string& part : options.parts)
    if (std::none_of(all.begin(), all.end(), [&](const Variant& v) { return v.part == part; })) {
      std::vector<std::string> names;
      for (const Variant& v : all) names.push_back(v.part);
      input_error("--parts: '{}' cannot be left out of {}{}", part, scene.file, suggestion(part, names, "what can is"));
    }
  for (Variant& v : all)
    if (options.parts.empty() || std::find(options.parts.begin(), options.parts.end(), v.part) != options.parts.end())
      out.push_back({std::move(v), {}, {}});
  const std::size_t total = static_cast<std::size_t>(options.repetitions) * (2 * out.size());
  std::size_t done = 0;
  const auto run = [&](const SceneSpec& s, const std::string& what) {
    if (options.stop && options.stop->load()) run_error("stopped before the study was done; run the same command again, it starts anew");
    if (options.progress) options.progress(done++, total, what);
    return run_alone(s, options.folder / "leave_out_run");
  };
  for (int r = 0; r < options.repetitions; ++r)
    for (std::size_t i = 0; i < out.size(); ++i) {
      LeaveOut& l = out[i];
      // The whole beside every variant, before or after it by turns: a machine that slows down favours neither.
      if ((r + i) % 2 == 0) l.with.push_back(run(scene, "whole"));
      l.without.push_back(run(l.variant.scene, "without " + l.variant.part));
      if ((r + i) % 2 != 0) l.with.push_back(run(scene, "whole"));
    }
  return out;
}

StudyResult leave_out_study(const std::string& title, const std::vector<LeaveOut>& measured) {
  StudyResult result;
  result.title = title;
  result.table = fmt::format(
      "# {}\n\nOne thread, processor seconds without the loading of species; medians of {} pairs of runs, each a process of its own.\n"
      "A ratio is held against {} where the uncertainty of the saving is at most a tenth of what the stages take, and there are five pairs.\n\n"
      "| left out | its stages, s | saved, s | uncertainty, s | ratio | whole, s | peak memory saved, MB | of, MB |\n|---|---|---|---|---|---|---|---|\n",
      title, measured.empty() ? 0 : measured[0].with.size(), least_ratio);
  for (const LeaveOut& l : measured) {
    std::vector<double> saved, memory, stages, whole, peak;
    for (std::size_t i = 0; i < l.with.size(); ++i) {
      saved.push_back(l.with[i].seconds - l.without[i].seconds);
      memory.push_back(l.with[i].peak_megabytes - l.without[i].peak_megabytes);
      stages.push_back(stage_seconds(l.with[i], l.variant.stages));
      whole.push_back(l.with[i].seconds);
      peak.push_back(l.with[i].peak_megabytes);
    }
    const double middle = median(saved), stage = median(stages);
    // Standard error of a median, from the median absolute deviation as if scattered normally.
    std::vector<double> deviation;
    for (const double s : saved) deviation.push_back(std::abs(s - middle));
    const double uncertainty = 1.4826 * 1.2533 * median(deviation) / std::sqrt(static_cast<double>(saved.size()));
    const double ratio = stage > 0 ? middle / stage : std::numeric_limits<double>::quiet_NaN();
    const bool held = saved.size() >= fewest_pairs && uncertainty <= most_uncertainty * stage && stage > 0;
    result.table += fmt::format("| {} | {:.4f} | {:.4f} | {:.4f} | {} | {:.3f} | {:.1f} | {:.1f} |\n", l.variant.part, stage, middle, uncertainty,
                                stage > 0 ? fmt::format("{:.2f}{}", ratio, held ? "" : " (not held)") : "no stage", median(whole), median(memory),
                                median(peak));
    result.figures.push_back({l.variant.part + ": processor time saved", middle, "s", {}, {}});
    result.figures.push_back({l.variant.part + ": peak memory saved", median(memory), "MB", {}, {}});
    if (stage > 0) {
      Figure f{l.variant.part + ": time saved over the time its stages report", ratio, "", {}, {}};
      if (held) f.at_least = least_ratio;
      result.figures.push_back(f);
    }
  }
  return result;
}

}  // namespace moomill
