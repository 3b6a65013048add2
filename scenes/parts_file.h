#pragma once
// Reads [[builder.parts]] of a species file (docs/species.md has the keys).
#include "rigs/parts.h"
#include "generator/core/toml.h"

namespace moomill {

PartSpec read_part(TomlReader r);

}  // namespace moomill
