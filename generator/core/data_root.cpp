#include "generator/core/data_root.h"

#include <cstdlib>

namespace moomill {

std::filesystem::path data_root() {
  const char* home = std::getenv("MOOMILL_HOME");
  return home && *home ? home : MOOMILL_SOURCE_DIR;
}

}  // namespace moomill
