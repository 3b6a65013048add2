#pragma once
// What a species file says of itself, without its rig being read or built.
#include <filesystem>
#include <optional>
#include <string>

namespace moomill {

struct SpeciesSummary {
  std::string name;
  bool has_file = false;  // false: a bare rig file
  bool built = false;     // by a builder, not read from a mesh file
  std::size_t keypoints = 0, limits = 0;
  std::optional<double> length, height;  // metres, as expected
};

// Of a species name or path, as find_species() takes it. Does not check the file any further than it needs.
SpeciesSummary summarize_species(const std::string& species, const std::filesystem::path& relative_to);

}  // namespace moomill
