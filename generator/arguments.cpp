#include "generator/arguments.h"

#include <charconv>

#include "generator/core/error.h"

namespace moomill {
namespace {

constexpr int longest_list = 1'000'000;

// A whole number of at least 0 that is all of `text`.
std::optional<int> whole(const std::string& text) {
  int value = 0;
  const char* end = text.data() + text.size();
  const auto [stopped, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || stopped != end || text.empty() || value < 0) return std::nullopt;
  return value;
}

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == separator)
      parts.emplace_back();
    else
      parts.back() += c;
  }
  return parts;
}

}  // namespace

std::pair<std::optional<int>, std::optional<int>> parse_range(const std::string& option, const std::string& text) {
  const std::vector<std::string> parts = split(text, ':');
  auto wrong = [&]() {
    input_error("{}: '{}' is no range; write A:B, A: or :B, both ends included, or one number", option, text);
  };
  std::optional<int> first = whole(parts[0]), last = parts.size() == 1 ? first : whole(parts[1]);
  if (parts.size() > 2 || (!first && !parts[0].empty()) || (parts.size() == 2 && !last && !parts[1].empty())) wrong();
  if (!first && !last) wrong();
  return {first, last};
}

std::vector<int> parse_list(const std::string& option, const std::string& text) {
  std::vector<int> out;
  for (const std::string& part : split(text, ',')) {
    const std::vector<std::string> ends = split(part, ':');
    const std::optional<int> first = whole(ends[0]), last = ends.size() == 2 ? whole(ends[1]) : first;
    if (!first || !last || ends.size() > 2 || *last < *first || *last - *first > longest_list)
      input_error("{}: '{}' is no list of numbers; write e.g. 0,2,5:7", option, text);
    for (int i = *first; i <= *last; ++i) out.push_back(i);
  }
  return out;
}

std::pair<int, int> parse_resolution(const std::string& text) {
  const std::vector<std::string> parts = split(text, 'x');
  const std::optional<int> width = whole(parts[0]), height = parts.size() == 2 ? whole(parts[1]) : std::nullopt;
  if (!width || !height) input_error("--resolution: '{}' is no size; write WIDTHxHEIGHT, e.g. 1024x768", text);
  return {*width, *height};
}

std::pair<int, int> parse_shard(const std::string& text) {
  const std::vector<std::string> parts = split(text, '/');
  const std::optional<int> index = whole(parts[0]), count = parts.size() == 2 ? whole(parts[1]) : std::nullopt;
  if (!index || !count || *count < 1 || *index >= *count)
    input_error("--shard: '{}' is no shard; write I/N with I from 0 to N - 1, e.g. 0/16", text);
  return {*index, *count};
}

std::vector<std::string> parse_words(const std::string& option, const std::string& text) {
  std::vector<std::string> words;
  for (const std::string& word : split(text, ',')) {
    if (word.empty()) input_error("{}: '{}' has an empty word; write e.g. rgb,depth", option, text);
    words.push_back(word);
  }
  return words;
}

Overrides parse_overrides(const SceneOptions& options) {
  Overrides o;
  if (!options.frames.empty()) std::tie(o.first_frame, o.last_frame) = parse_range("--frames", options.frames);
  if (!options.cameras.empty()) o.cameras = parse_list("--cameras", options.cameras);
  if (!options.coats.empty()) o.coats = parse_list("--coats", options.coats);
  if (!options.modalities.empty()) o.modalities = parse_words("--modalities", options.modalities);
  if (!options.resolution.empty()) o.resolution = parse_resolution(options.resolution);
  o.samples = options.samples;
  o.target_error = options.target_error;
  if (options.surface_light) o.surface_light = true;
  return o;
}

}  // namespace moomill
