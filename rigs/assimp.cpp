#include "generator/core/error.h"
#include "rigs/rig.h"

namespace moomill {
Rig load_with_assimp(const std::filesystem::path& file, const LoadOptions&) {
  run_error("{}: FBX, Collada and OBJ are not read yet", file.string());
}
}  // namespace moomill
