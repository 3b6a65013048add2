// Commands that measure what the project claims: each runs a study, prints its table, writes it where -o says.
#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/dataset/codecs.h"
#include "scenes/scene.h"
#include "validate/studies/crosscheck.h"
#include "validate/studies/deformation.h"
#include "validate/studies/motion.h"
#include "validate/studies/silhouette.h"
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

namespace {

// At most n of a list, spread evenly over it.
std::vector<int> some_of(const std::vector<int>& all, std::size_t n) {
  if (all.size() <= n) return all;
  std::vector<int> some;
  for (std::size_t i = 0; i < n; ++i) some.push_back(all[i * all.size() / n]);
  return some;
}

}  // namespace

int run_crosscheck(const CrosscheckCommand& command) {
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
  if (!command.timing.empty()) options.timing_samples = parse_list("--timing", command.timing);
  // A whole dataset would take Cycles days: without a word, three cameras and two coats stand for all.
  Overrides few;
  if (overrides.cameras.empty() && scene.cameras.only.empty()) few.cameras = some_of(all_camera_ids(scene.cameras), 3);
  if (overrides.coats.empty()) few.coats = some_of(scene.coat_indices, 2);
  apply_overrides(scene, few);
  return finish_study(options.timing_samples.empty() ? crosscheck(scene, options) : time_cycles(scene, options), command.out);
}

}  // namespace moomill
