#include "generator/core/error.h"
#include "rigs/rig.h"

namespace moomill {
void write_glb(const Rig&, const std::filesystem::path& file) { run_error("{}: cannot be written yet", file.string()); }
}  // namespace moomill
