// Commands that measure what the project claims: each runs a study, prints its table, writes it where -o says.
#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/dataset/codecs.h"
#include "scenes/scene.h"
#include "validate/studies/deformation.h"
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

int run_stress_study(const StressCommand& command) {
  StressOptions options;
  options.edge_rays = command.rays;
  options.group = command.group;
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

}  // namespace moomill
