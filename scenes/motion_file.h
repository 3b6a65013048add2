#pragma once
// The clips of a species, rigs/<species>/motion/*.toml: see rigs/cow/motion/README.md for the keys.
#include <filesystem>
#include <vector>

#include "rigs/motion.h"

namespace moomill {

// One clip a file, named after it, in alphabetical order. A folder that is not there holds none.
std::vector<ClipSpec> read_motion(const std::filesystem::path& folder);

}  // namespace moomill
