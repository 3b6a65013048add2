// Commands that measure what the project claims: each runs a study, prints its table, writes it where -o says.
#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/dataset/codecs.h"
#include "generator/progress_bar.h"
#include "scenes/scene.h"
#include "validate/studies/converge.h"
#include "validate/studies/crosscheck.h"
#include "validate/studies/deformation.h"
#include "validate/studies/leave_out.h"
#include "validate/studies/motion.h"
#include "validate/studies/silhouette.h"
#include "validate/studies/stress.h"
#include "validate/studies/study.h"

namespace moomill {

namespace fs = std::filesystem;

int finish_study(const StudyResult& result, const std::string& folder) {
  print(result.table);
  int missed = 0;
  for (const Figure& f : result.figures) {
    if (!f.at_most && !f.at_least) continue;
    missed += !f.holds();
    const double bound = f.at_most ? *f.at_most : *f.at_least;
    print(fmt::format("{:<6} {}: {:.4g} {}(bound: {} {:.4g})\n", f.holds() ? "ok" : "MISSED", f.name, f.value,
                      f.unit.empty() ? "" : f.unit + " ", f.at_most ? "at most" : "at least", bound));
  }
  if (!folder.empty()) write_study(result, folder);
  return missed > 0 ? 1 : 0;
}

namespace {

// At most n of a list, spread evenly over it.
std::vector<int> some_of(const std::vector<int>& all, std::size_t n) {
  if (all.size() <= n) return all;
  std::vector<int> some;
  for (std::size_t i = 0; i < n; ++i) some.push_back(all[i * all.size() / n]);
  return some;
}

}  // namespace

int run_converge(const ConvergeCommand& command, std::atomic<bool>& stop) {
  SceneSpec scene = read_scene(command.scene);
  apply_overrides(scene, parse_overrides(command.options));
  ConvergeOptions options;
  if (command.min_samples > command.max_samples) input_error("--min-spp {}: more than --max-spp {}; nothing would be measured", command.min_samples, command.max_samples);
  options.min_samples = command.min_samples;
  options.max_samples = command.max_samples;
  options.repetitions = command.repetitions;
  options.reference_samples = command.reference_samples;
  options.threads = command.threads;
  if (!command.target_errors.empty())
    for (const std::string& word : parse_words("--target-errors", command.target_errors)) {
      char* end = nullptr;
      const double e = std::strtod(word.c_str(), &end);
      if (*end != 0 || !(e >= least_target_error) || e > 1) input_error("--target-errors: '{}' is no relative error from {} to 1; write e.g. 0.1,0.05", word, least_target_error);
      options.target_errors.push_back(e);
    }
  options.stop = &stop;
  const std::vector<int> cameras = read_scene(command.scene).cameras.only;
  options.cameras_per_frame = static_cast<int>(cameras.empty() ? all_camera_ids(scene.cameras).size() : cameras.size());
  // Small unless told otherwise: a reference costs sixteen times the largest picture.
  if (command.options.frames.empty()) scene.frames.resize(1);
  if (command.options.cameras.empty())
    scene.cameras.only = some_of(scene.cameras.only.empty() ? all_camera_ids(scene.cameras) : scene.cameras.only, 3);
  if (command.options.coats.empty() && scene.coat_indices.size() > 2) scene.coat_indices = {scene.coat_indices.front(), scene.coat_indices.back()};
  if (command.options.resolution.empty()) {
    const int width = std::min(160, scene.cameras.width);
    scene.cameras.height = std::max(1, scene.cameras.height * width / scene.cameras.width);
    scene.cameras.width = width;
  }
  std::optional<Against> against;
  if (!command.against.empty()) {
    against = Against{read_convergence(command.against), command.at_samples};
    require_common_pictures(scene, *against);
  }
  require_study_folder(command.out);
  Convergence measured;
  {
    ProgressBar bar("samples");
    options.progress = [&bar](std::size_t done, std::size_t total, const std::string& stage) { bar.update(done, total, stage); };
    measured = measure_convergence(scene, options);
  }
  const fs::path out = command.out;
  write_file_atomically(out / convergence_file, convergence_csv(measured.rows));
  const std::string title = fmt::format("Error against run time: {}, {} x {}", fs::path(command.scene).filename().string(), scene.cameras.width, scene.cameras.height);
  const StudyResult result = convergence_study(title, measured, command.slope_at_most, against);
  for (const auto& [name, text] : convergence_plots(measured, against)) write_file_atomically(out / name, text);
  const int missed = finish_study(result, command.out);
  return command.enforce ? missed : 0;
}

int run_leave_out(const LeaveOutCommand& command, std::atomic<bool>& stop) {
  SceneSpec scene = read_scene(command.scene);
  if (command.options.frames.empty()) scene.frames.resize(1);
  apply_overrides(scene, parse_overrides(command.options));
  LeaveOutOptions options;
  options.repetitions = command.repetitions;
  options.folder = command.out;
  if (!command.parts.empty()) options.parts = parse_words("--parts", command.parts);
  options.stop = &stop;
  require_study_folder(command.out);
  std::vector<LeaveOut> measured;
  {
    ProgressBar bar("runs");
    options.progress = [&bar](std::size_t done, std::size_t total, const std::string& stage) { bar.update(done, total, stage); };
    measured = measure_leave_out(scene, options);
  }
  const std::string title = fmt::format("What leaving out saves: {}, {} frames, {} x {}", fs::path(command.scene).filename().string(),
                                        scene.frames.size(), scene.cameras.width, scene.cameras.height);
  const int missed = finish_study(leave_out_study(title, measured), command.out);
  return command.enforce ? missed : 0;
}

int run_stress_study(const StressCommand& command, const std::atomic<bool>& stop) {
  StressOptions options;
  options.stop = &stop;
  options.edge_rays = command.rays;
  options.group = command.group;
  if (!options.group.empty()) stress_cases(options.group);  // refused before anything is made
  require_study_folder(command.out);
  const std::vector<StressOutcome> outcomes = run_stress(options);
  const StudyResult result = stress_study(outcomes);
  print(result.table);
  int out_of_bounds = 0;
  for (const StressOutcome& o : outcomes) {
    if (o.holds()) continue;
    ++out_of_bounds;
    print(fmt::format("OUT    {}: {}: {}\n", o.group, o.what.name,
                      o.failure.empty() ? fmt::format("{:.3g} {}(allowed: {:.3g})", o.error, o.what.unit.empty() ? "" : o.what.unit + " ", o.what.allowed)
                                        : o.failure));
  }
  print(fmt::format("{} of {} cases within bounds; every case is in {}\n", outcomes.size() - out_of_bounds, outcomes.size(),
                    (fs::path(command.out) / "stress.md").string()));
  write_study(result, command.out);
  write_stress(outcomes, command.out);
  return command.enforce && out_of_bounds > 0 ? 1 : 0;
}

int run_rig_compare(const CompareCommand& command) {
  const SilhouetteReference reference = read_silhouette_reference(find_file(command.reference, {}));
  const SilhouetteMesh mesh = load_silhouette_reference(reference);
  const Species species = read_species(command.rig, NnopcsNormalization::box, {});
  const SilhouetteFit fit = fit_silhouettes(species, reference, mesh);
  const StudyResult result = silhouette_study(species, reference, fit);
  const std::vector<std::uint8_t> png = encode_png8(silhouette_sheet(fit, result.title));
  write_file_atomically(std::filesystem::path(command.out) / "silhouettes.png", png.data(), png.size());
  return finish_study(result, command.out);
}

int run_rig_deform(const std::string& file, const SceneOptions& options, const std::string& folder) {
  SceneSpec scene = read_scene(file);
  apply_overrides(scene, parse_overrides(options));
  const Species species = read_species(scene.animals[0].species, scene.normalization, fs::path(scene.file).parent_path());
  std::vector<Pose> poses;
  for (const int frame : scene.frames)
    poses.push_back(pose_of_frame(scene, scene.animals[0], species, frame - scene.first_frame));
  return finish_study(study_deformation(species, poses, scene.frames.front()), folder);
}

int run_rig_motion(const std::string& source, int samples, const std::string& folder) {
  const MotionOptions options{samples};
  const bool is_scene = fs::path(source).extension() == ".toml" && fs::is_regular_file(source) && is_scene_file(source);
  if (!is_scene) return finish_study(study_motion(read_species(source, NnopcsNormalization::box, {}), options), folder);
  const SceneSpec scene = read_scene(source);
  const Species species = read_species(scene.animals[0].species, scene.normalization, fs::path(scene.file).parent_path());
  return finish_study(study_motion(scene, species, options), folder);
}

int run_crosscheck(const CrosscheckCommand& command, const std::atomic<bool>& stop) {
  SceneSpec scene = read_scene(command.scene);
  Overrides overrides = parse_overrides(command.options);
  apply_overrides(scene, overrides);
  CrosscheckOptions options;
  options.out = command.out;
  options.blender = command.blender;
  options.frame = command.frame;
  options.label_scale = command.label_scale;
  options.threads = command.threads;
  options.reference_samples = command.reference;
  options.stop = &stop;
  if (!command.timing.empty()) options.timing_samples = parse_list("--timing", command.timing);
  for (const int n : options.timing_samples)
    if (n < 1 || n > largest_samples) input_error("--timing: {} is no number of samples; 1 to {}", n, largest_samples);
  // A whole dataset would take Cycles days: without a word, three cameras and two coats stand for all.
  Overrides few;
  if (overrides.cameras.empty() && scene.cameras.only.empty()) few.cameras = some_of(all_camera_ids(scene.cameras), 3);
  if (overrides.coats.empty()) few.coats = some_of(scene.coat_indices, 2);
  apply_overrides(scene, few);
  const int missed = finish_study(options.timing_samples.empty() ? crosscheck(scene, options) : time_cycles(scene, options), command.out);
  return command.enforce ? missed : 0;
}

}  // namespace moomill
