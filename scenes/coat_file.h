#pragma once
// The keys of a procedural coat, shared by coat files and breed files.
#include "generator/core/toml.h"
#include "textures/coat.h"

namespace moomill {

// Reads [patches], [plain], [freckles], [[marks]], [[parts]], seed and fur; leaves finish() to the caller.
ProceduralCoat read_procedural_coat(TomlReader& reader);

}  // namespace moomill
