#pragma once
// What is written on the command line, as values; InputError says how to write it.
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scenes/scene.h"

namespace moomill {

// "3:7", "3:", ":7" or "5": first and last, both included.
std::pair<std::optional<int>, std::optional<int>> parse_range(const std::string& option, const std::string& text);
std::vector<int> parse_list(const std::string& option, const std::string& text);           // "0,2,5:7"
std::pair<int, int> parse_resolution(const std::string& text);                             // "1024x768"
std::pair<int, int> parse_shard(const std::string& text);                                  // "3/16": index, count
std::vector<std::string> parse_words(const std::string& option, const std::string& text);  // "rgb,depth"

// The options that change a scene, as written.
struct SceneOptions {
  std::string frames, cameras, coats, modalities, resolution;
  std::optional<int> samples;
  std::optional<double> target_error;
  bool surface_light = false;
};
Overrides parse_overrides(const SceneOptions& options);

}  // namespace moomill
