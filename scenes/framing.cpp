// Default cameras fitted to the size a species file expects.
#include "scenes/scene.h"
#include "scenes/toml.h"

namespace moomill {

CameraFraming default_framing(const std::string& species, const std::filesystem::path& relative_to) {
  CameraFraming framing;
  const std::filesystem::path file = find_species(species, relative_to);
  if (file.extension() != ".toml") return framing;
  const toml::table table = TomlReader::parse(file);
  TomlReader reader(table, file.string());
  if (!reader.has("expected_length_m") || !reader.has("expected_height_m")) return framing;
  // The defaults are for an animal 2.2 m long and 1.65 m high; others get the same picture at their scale.
  const double scale = std::max(reader.number("expected_length_m", 1e-3, 1e4) / 2.2,
                                reader.number("expected_height_m", 1e-3, 1e4) / 1.65);
  framing.target *= scale;
  framing.radius *= scale;
  for (double& h : framing.heights) h *= scale;
  return framing;
}

}  // namespace moomill
