// What can be known of a species at once, and default cameras fitted to its size.
#include "scenes/scene.h"
#include "scenes/species_summary.h"
#include "generator/core/toml.h"

namespace moomill {

SpeciesSummary summarize_species(const std::string& species, const std::filesystem::path& relative_to) {
  const std::filesystem::path file = find_species(species, relative_to);
  SpeciesSummary summary;
  summary.name = file.stem().string();
  if (file.extension() != ".toml") return summary;
  const toml::table table = TomlReader::parse(file);
  TomlReader reader(table, file.string());
  summary.has_file = true;
  summary.name = reader.text("name", summary.name);
  summary.keypoints = reader.tables("keypoints").size();
  summary.limits = reader.tables("limits").size();
  if (auto source = reader.table("source")) summary.built = source->has("builder");
  if (reader.has("expected_length_m")) summary.length = reader.number("expected_length_m", 1e-3, 1e4);
  if (reader.has("expected_height_m")) summary.height = reader.number("expected_height_m", 1e-3, 1e4);
  return summary;
}

CameraFraming default_framing(const std::string& species, const std::filesystem::path& relative_to) {
  CameraFraming framing;
  const SpeciesSummary summary = summarize_species(species, relative_to);
  double length = summary.length.value_or(0), height = summary.height.value_or(0);
  if (!summary.length || !summary.height) {  // a bare rig file, or a species that does not say: measured
    try {
      const Box box = read_species(species, NnopcsNormalization::box, relative_to).rig.surface.neutral_box;
      length = std::max(box.size().x, box.size().y);
      height = box.size().z;
    } catch (const InputError&) {  // a broken rig is refused where it is loaded; the scene's own mistakes come first
      return framing;
    }
  }
  // The defaults are for an animal 2.2 m long and 1.65 m high; others get the same picture at their scale.
  const double scale = std::max(length / 2.2, height / 1.65);
  if (!(scale > 0)) return framing;
  framing.target *= scale;
  framing.radius *= scale;
  for (double& h : framing.heights) h *= scale;
  return framing;
}

}  // namespace moomill
