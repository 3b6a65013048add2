// `moomill plan`: what generate() would do for a scene, and what it would cost.
#include <set>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "scenes/appearance.h"
#include "scenes/generate.h"
#include "scenes/species_summary.h"

namespace moomill {
namespace {

// Bytes of a file per pixel of the picture, background included, measured on the shipped cow at 1024 x 768 by
//   moomill generate scenes/nepumoo.toml --frames 40 --cameras 0:7 --modalities all -o DIR
// and the sizes of the files in DIR.
double bytes_per_pixel(Modality m) {
  switch (m) {
    case Modality::rgb:
      return 0.08;
    case Modality::silhouette:
      return 0.006;
    case Modality::coverage:
      return 0.015;
    case Modality::depth:
      return 0.46;
    case Modality::nnopcs:
      return 1.45;  // with the 8-bit file beside it
    case Modality::normal:
      return 1.42;
    case Modality::uv:
      return 0.91;
    case Modality::part:
      return 0.011;
    case Modality::instance:
      return 0.006;
    case Modality::triangle:
      return 1.12;
    case Modality::occlusion:
      return 0.006;
    case Modality::keypoints:
    case Modality::count:
      return 0;
  }
  return 0;
}

// Seconds of one core, measured by the processor time of such runs with one modality, 1 and 64 samples, 1 and 12 coats.
constexpr double core_seconds_per_sample = 8e-8;       // one path sample of one pixel of the whole picture, first coat
constexpr double share_per_further_coat = 0.02;        // of the above
constexpr double core_seconds_per_label_pixel = 3e-8;  // first hit and the maps made of it
constexpr double core_seconds_per_frame = 0.1;         // pose, skinning, hierarchy
constexpr double core_seconds_to_start = 2;            // rig and NNOPCS
constexpr double core_seconds_per_coat_texel = 2.7e-7;
double encoder_seconds_per_pixel(Modality m) {
  switch (row(m).storage) {
    case Storage::jpeg8:
      return 2.5e-8;
    case Storage::png8:
    case Storage::png16:
      return 2.0e-8;
    case Storage::exr32:
    case Storage::exr_ids:
      return 1.6e-8 + 8e-9 * row(m).channels;
    case Storage::record:
      return 0;
  }
  return 0;
}

struct Stage {
  std::string name;
  bool runs = false;
  std::string why;  // it runs, or is left out
};

struct Counts {
  std::size_t frames = 0, cameras = 0, coats = 0, animals = 0;
  double pixels = 0;  // per picture
  std::size_t views() const { return frames * cameras * coats; }
  std::size_t pictures() const { return frames * cameras; }
};

std::size_t files_of(const Counts& n, Modality m) {
  const ModalityRow& r = row(m);
  if (r.storage == Storage::record) return 0;
  std::size_t files = n.pictures() * (r.per_coat ? n.coats : 1);
  if (m == Modality::nnopcs) files *= 2;             // float32, and 8 bits beside it
  if (m == Modality::occlusion) files *= n.animals;  // a whole mask each
  return files;
}

std::string names_of(const ModalitySet& set, bool ModalityRow::*need) {
  std::string out;
  for (const ModalityRow& r : modality_table())
    if (set.has(r.id) && r.*need) out += (out.empty() ? "" : ", ") + std::string(r.name);
  return out;
}

std::string human_bytes(double bytes) {
  const char* units[] = {"B", "kB", "MB", "GB", "TB", "PB"};
  int u = 0;
  while (bytes >= 1000 && u < 5) bytes /= 1000, ++u;
  return fmt::format("{:.{}f} {}", bytes, bytes < 10 && u > 0 ? 1 : 0, units[u]);
}

std::string coats_text(const SceneSpec& scene, const Counts& n) {
  const std::size_t all = scene.animals[0].coats.size();
  if (!scene.modalities.any(&ModalityRow::needs_light)) return "";
  const BatchPlan batch = plan_batches(scene);
  const std::size_t batches = (n.coats + batch.coats - 1) / batch.coats;
  if (batches == 1) return fmt::format("{} of {}, traced in one go", n.coats, all);
  return fmt::format("{} of {}, traced in {} batches of {} (labels once), {}; {} in memory", n.coats, all, batches, batch.coats,
                     static_cast<std::size_t>(batch.kept) >= batches ? "each baked once"
                                                                    : fmt::format("{} kept, the others baked for every frame", batch.kept),
                     human_bytes(batch.bytes));
}

std::vector<Stage> stages_of(const SceneSpec& scene, const Counts& n, const SpeciesSummary& species, const ProbeReport* probed) {
  const ModalitySet& m = scene.modalities;
  const std::string light = names_of(m, &ModalityRow::needs_light), hits = names_of(m, &ModalityRow::needs_first_hit),
                    uv = names_of(m, &ModalityRow::needs_uv);
  const bool keypoints = m.has(Modality::keypoints), occlusion = m.has(Modality::occlusion);
  const bool coverage = m.has(Modality::coverage), nnopcs = m.has(Modality::nnopcs);
  const bool traced = !light.empty() || !hits.empty() || keypoints || coverage;
  const std::string no_light = "no chosen modality needs light (rgb does)";
  std::vector<Stage> stages;
  auto add = [&](const char* name, bool runs, const std::string& why, const std::string& why_not) {
    stages.push_back({name, runs, runs ? why : why_not});
  };
  add("rig", true, (species.built ? "built from " : "read from ") + scene.animals[0].species, "");
  add("poses", true, fmt::format("{} frames", n.frames), "");
  add("skinning", traced, "once per pose, shared by all cameras and coats", "nothing is traced");
  add("NNOPCS", nnopcs, "baked once on the neutral pose", "nnopcs is not among the modalities");
  add("UVs", !uv.empty(), "for " + uv, "no chosen modality needs them (rgb and uv do)");
  add("coats", !light.empty(), coats_text(scene, n), no_light);
  add("lights", !light.empty(),
      fmt::format("{}, {} suns, {} rectangles",
                  scene.light.environment_file ? "environment map" : "constant environment", scene.light.suns.size(),
                  scene.light.rectangles.size()),
      no_light);
  add("Embree hierarchy", traced, "once per pose", "nothing is traced");
  add("first hits", !hits.empty(), "for " + hits, "no chosen modality needs the pixel-centre rays");
  add("path tracing", !light.empty(),
      fmt::format("{}, {}", scene.render.target_error > 0
                               ? fmt::format("samples for a relative error of {} ({})", scene.render.target_error,
                                             probed ? fmt::format("about {:.0f} per pixel in the mean, and 8 of a pilot", probed->wanted_samples)
                                                    : fmt::format("the time below is of {} samples per pixel", scene.render.samples))
                               : fmt::format("{} samples per pixel", scene.render.samples),
                  scene.render.max_bounces > 0 ? fmt::format("at most {} bounces", scene.render.max_bounces)
                                               : "no cap on bounces"),
      no_light);
  add("coverage", coverage, "antialiased share of every pixel", "coverage is not among the modalities");
  add("keypoints", keypoints,
      species.keypoints ? fmt::format("{} of {}", species.keypoints, species.name)
                        : fmt::format("{} names none, so only joints are recorded", species.name),
      "keypoints is not among the modalities");
  add("occlusion", occlusion, fmt::format("whole masks of {} animals", n.animals),
      "occlusion is not among the modalities");
  std::size_t files = 0;
  for (const ModalityRow& r : modality_table())
    if (m.has(r.id)) files += files_of(n, r.id);
  add("encoders", files > 0, fmt::format("{} files", files), "all that is asked for goes into the frame records");
  return stages;
}

std::string human_time(double seconds) {
  if (seconds < 60) return fmt::format("{:.0f} s", std::max(1.0, seconds));
  if (seconds < 3600) return fmt::format("{:.0f} min", seconds / 60);
  if (seconds < 48 * 3600) return fmt::format("{:.1f} h", seconds / 3600);
  return fmt::format("{:.1f} days", seconds / 86400);
}

}  // namespace

PlanReport plan(const SceneSpec& scene, const ProbeReport* probed) {
  check(!scene.animals.empty() && !scene.frames.empty(), "a scene without animals or frames");
  const std::filesystem::path folder = std::filesystem::path(scene.file).parent_path();
  const SpeciesSummary species = summarize_species(scene.animals[0].species, folder);
  Counts n;
  n.frames = scene.frames.size();
  n.cameras = cameras_of_frame(scene, scene.frames[0]).size();
  n.coats = scene.coat_indices.size();
  n.animals = scene.animals.size();
  n.pixels = static_cast<double>(scene.cameras.width) * scene.cameras.height;

  PlanReport report;
  Json& json = report.json;
  json["frames"] = n.frames;
  json["cameras"] = n.cameras;
  json["coats"] = n.coats;
  json["views"] = n.views();
  json["resolution"] = {scene.cameras.width, scene.cameras.height};
  std::string& text = report.text;
  text += fmt::format("{}: {} frames x {} cameras x {} coats = {} views of {} x {}\n\n", scene.file, n.frames,
                      n.cameras, n.coats, n.views(), scene.cameras.width, scene.cameras.height);

  text += fmt::format("{:<18}{:<10}\n", "stage", "");
  json["stages"] = Json::array();
  for (const Stage& s : stages_of(scene, n, species, probed)) {
    text += fmt::format("{:<18}{:<10} {}\n", s.name, s.runs ? "runs" : "left out:", s.why);
    json["stages"].push_back({{"name", s.name}, {"runs", s.runs}, {"why", s.why}});
  }

  text += fmt::format("\n{:<18}{:>10}  {:>9}\n", "modality", "files", "disk");
  double bytes = 0, core_seconds = core_seconds_to_start + core_seconds_per_frame * static_cast<double>(n.frames);
  std::size_t files = 0;
  json["modalities"] = Json::array();
  for (const ModalityRow& r : modality_table()) {
    if (!scene.modalities.has(r.id)) continue;
    const std::size_t own_files = files_of(n, r.id);
    // Of the two NNOPCS files the figure per pixel covers both.
    const double images = static_cast<double>(r.id == Modality::nnopcs ? own_files / 2 : own_files);
    const double own_bytes = images * n.pixels * bytes_per_pixel(r.id);
    text += r.storage == Storage::record
                ? fmt::format("{:<18}{:>10}  {:>9}\n", r.name, "records", "")
                : fmt::format("{:<18}{:>10}  {:>9}\n", r.name, own_files, human_bytes(own_bytes));
    json["modalities"].push_back({{"name", r.name}, {"files", own_files}, {"bytes", std::llround(own_bytes)}});
    bytes += own_bytes;
    files += own_files;
    core_seconds += images * n.pixels * encoder_seconds_per_pixel(r.id);
  }
  const double pictures = static_cast<double>(n.pictures());
  // Bones of every frame; keypoints, and hashes of the files, of every picture.
  const double records = 8000.0 * static_cast<double>(n.frames) +
                         125.0 * pictures * static_cast<double>(species.keypoints * n.animals) +
                         60.0 * static_cast<double>(files);
  bytes += records;
  if (scene.modalities.any(&ModalityRow::needs_first_hit))
    core_seconds += pictures * n.pixels * core_seconds_per_label_pixel;
  if (scene.modalities.any(&ModalityRow::needs_light)) {
    core_seconds += core_seconds_per_coat_texel * static_cast<double>(n.coats) * scene.render.coat_resolution *
                    scene.render.coat_resolution;
    const double batches = std::ceil(static_cast<double>(n.coats) / plan_batches(scene).coats);
    core_seconds += pictures * n.pixels * scene.render.samples * core_seconds_per_sample *
                    (batches + share_per_further_coat * (static_cast<double>(n.coats) - batches));
  }
  const int cores = hardware_threads();
  const double seconds = probed ? probed->seconds : core_seconds / cores;
  text += fmt::format("\n{} files, about {} on disk; about {} on the {} cores of this machine.\n", files,
                      human_bytes(bytes), human_time(seconds), cores);
  if (probed) {
    const ProbeReport& p = *probed;
    text += fmt::format("Processor time {}: start {:.2g} s, coats {:.2g} s, each frame {:.2g} s, each of {} pictures {:.2g} s for labels", human_time(p.processor_seconds),
                        p.start.processor, p.baking.processor, p.frame, n.pictures(), p.labels);
    if (p.light > 0) text += fmt::format(", {:.2g} s for light and {:.2g} s for writing {} coats", p.light, p.encoding, n.coats);
    text += fmt::format(".\nMeasured on {} pictures{} in {:.1f} s after loading.\n", p.views,
                        p.light > 0 && (scene.render.target_error > 0 || p.samples < scene.render.samples) ? fmt::format(" of {} samples", p.samples) : "", p.took);
    json["processor_seconds"] = p.processor_seconds;
    json["probe"] = {{"seconds", p.took},
                     {"pictures", p.views},
                     {"samples", p.samples},
                     {"wanted_samples", p.wanted_samples},
                     {"start", {{"processor", p.start.processor}, {"elapsed", p.start.elapsed}}},
                     {"coats", {{"processor", p.baking.processor}, {"elapsed", p.baking.elapsed}}},
                     {"frame", p.frame},
                     {"labels_of_picture", p.labels},
                     {"light_of_picture", p.light},
                     {"encoding_of_picture", p.encoding}};
  } else {
    text += "By typical figures, nothing was loaded; a probe is closer.\n";
    json["processor_seconds"] = core_seconds;
  }
  json["files"] = files;
  json["bytes"] = std::llround(bytes);
  json["seconds"] = seconds;
  json["cores"] = cores;
  return report;
}

}  // namespace moomill
