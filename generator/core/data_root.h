#pragma once
#include <filesystem>

namespace moomill {

// Where the program's data lie (rigs, textures, scenes, configurations): MOOMILL_HOME, else the source tree it was built from.
std::filesystem::path data_root();

}  // namespace moomill
