#pragma once
// Breeds: files that say how the coats of a breed vary (textures/<species>/breeds/<name>.toml). A breed file holds a coat
// as in a coat file, in which any value may be a draw; an individual is that coat with every draw made. Whatever a coat
// file may say, a breed may vary. Documented in textures/cow/breeds/README.md.
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "textures/coat.h"

namespace moomill {

// What the literature says of a breed, for studies to compare with. Shares are of the surface.
struct PublishedRange {
  std::optional<double> mean, deviation, lower, upper;
};

struct BreedCoat;  // the coat with its draws, in breed_file.cpp

struct Breed {
  std::string name;     // the file's stem
  std::string species;  // whose coats these are
  std::string file, about;
  std::vector<std::string> sources;  // of the published ranges
  PublishedRange dark_share;         // share of the surface in dark hair
  PublishedRange patches;            // number of dark patches
  double smallest_patch = 0.005;     // square metres: smaller ones are not counted
  std::shared_ptr<const BreedCoat> coat;
};

// A breed by name or path, as find_breed(). InputError on what could ever be drawn and no coat may hold: the file is
// tried at both ends of every draw, with all its choices.
Breed read_breed(const std::string& name_or_path, const std::string& species, const std::filesystem::path& relative_to);

// Animal `index` of the herd `seed`: a pure function of (what the breed file says, seed, index), the same on every
// machine. Every draw is a hash of (seed, index, its place in the file); no other index is looked at. Its name is
// individual_name(). Thread-safe.
Coat individual(const Breed& breed, std::uint64_t seed, int index);

// "holstein_000007"
std::string individual_name(const std::string& breed, int index);

// Names of the breeds that ship for a species, sorted.
std::vector<std::string> shipped_breeds(const std::string& species);
// The file a breed name or path means; InputError names what there is.
std::filesystem::path find_breed(const std::string& name_or_path, const std::string& species,
                                 const std::filesystem::path& relative_to);

}  // namespace moomill
