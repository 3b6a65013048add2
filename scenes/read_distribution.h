#pragma once
// Reading a value-or-distribution of a scene file:
//   1.5   [1, 0, 0]   {uniform = [a, b]}   {normal = [mean, sigma], clamp = [a, b]}   {log_uniform = [a, b]}
//   {choose = [..]}   each with an optional  per = "frame" | "view"
#include <optional>

#include "scenes/scene.h"
#include "generator/core/toml.h"

namespace moomill {

// What may stand where a distribution is read.
struct Quantity {
  enum class Kind { number, vector, color, text } kind = Kind::number;  // color: three numbers, or one for a grey
  double lowest = -1e12, highest = 1e12;                                // of every component, of every possible draw
  bool may_vary_per_view = true;  // what moves the animals must be the same for all cameras of a frame
};

// A normal distribution without clamp is clamped to the quantity's own range, so no draw is ever illegal.
Distribution read_distribution(TomlReader& reader, const std::string& key, const Quantity& quantity,
                               const Distribution& fallback);
std::optional<Distribution> read_optional_distribution(TomlReader& reader, const std::string& key,
                                                       const Quantity& quantity);

}  // namespace moomill
