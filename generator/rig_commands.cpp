// `moomill rig ...`.
#include <spdlog/spdlog.h>

#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/core/error.h"
#include "rigs/check.h"
#include "generator/dataset/codecs.h"
#include "scenes/bind_file.h"
#include "scenes/scene.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

bool is_rig_file(const fs::path& file) {
  return file.extension() != ".toml";
}

int print_findings(const std::vector<Finding>& findings, const std::string& what) {
  int wrong = 0;
  for (const Finding& f : findings) {
    const bool is_wrong = f.level == Finding::Level::wrong;
    wrong += is_wrong;
    print(fmt::format("{:<11} {}\n", is_wrong ? "wrong" : "suspicious", f.text));
  }
  if (findings.empty()) print(fmt::format("{}: nothing wrong, nothing suspicious\n", what));
  return wrong > 0 ? 1 : 0;
}

}  // namespace

int run_rig_info(const std::string& rig) {
  const fs::path file = find_species(rig, {});
  const Rig loaded = is_rig_file(file) ? load_rig(file) : read_species(rig, NnopcsNormalization::box, {}).rig;
  for (const std::string& w : loaded.warnings) spdlog::warn("{}", w);
  print(describe_rig(loaded));
  return 0;
}

int run_rig_check(const std::string& rig) {
  const fs::path file = find_species(rig, {});
  if (is_rig_file(file)) return print_findings(check_rig(load_rig(file)), rig);
  return print_findings(check_species(read_species(rig, NnopcsNormalization::box, {})), rig);
}

int run_rig_build(const std::string& spec, const std::string& out) {
  require_extension("-o", out, ".glb");
  const Species species = read_species(spec, NnopcsNormalization::box, {});
  write_glb(species.rig, out);
  spdlog::info("{} holds {} triangles, {} joints and {} clips", out, species.rig.surface.triangles.size(),
               species.rig.bones.size(), species.rig.clips.size());
  return 0;
}

int run_rig_bind(const std::string& mesh, const std::string& keypoints, const std::string& out) {
  require_extension("-o", out, ".glb");
  const fs::path rig_file = out, species_file = fs::path(out).replace_extension(".toml");
  std::error_code error;
  if (fs::equivalent(species_file, keypoints, error))
    input_error("-o {}: its species file would overwrite {}; write to another folder or name", out, keypoints);
  const BoundScan bound = bind_scan_file(mesh, keypoints);
  for (const std::string& w : bound.species.rig.warnings) spdlog::warn("{}", w);
  for (const std::string& note : bound.notes) spdlog::info("{}", note);
  write_glb(bound.species.rig, rig_file);
  write_file_atomically(species_file, bound_species_toml(bound, rig_file.stem().string(), rig_file.filename().string(),
                                                         fs::path(keypoints).filename().string()));
  spdlog::info("{} holds {} triangles, {} joints and {} clips; {} is its species file, name that in a scene", out,
               bound.species.rig.surface.triangles.size(), bound.species.rig.bones.size(), bound.species.rig.clips.size(),
               species_file.string());
  return 0;
}

}  // namespace moomill
