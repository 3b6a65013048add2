#pragma once
// What several commands share.
#include <atomic>
#include <cstdio>
#include <filesystem>
#include <string>

#include "generator/core/error.h"

namespace moomill {

// To stdout, where results go.
inline void print(const std::string& text) {
  std::fputs(text.c_str(), stdout);
}

inline void require_extension(const std::string& option, const std::string& file, const std::string& extension) {
  if (std::filesystem::path(file).extension() != extension) input_error("{} {}: the file must end in {}", option, file, extension);
}

class ProgressBar;
struct GenerateOptions;
// With the bar that shows how far it is, and the flag that ends it early.
GenerateOptions generate_options(const std::filesystem::path& out, ProgressBar& bar, std::atomic<bool>& stop);

}  // namespace moomill
