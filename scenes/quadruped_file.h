#pragma once
// The [builder] table of a species file: see rigs/README.md for its keys.
#include "rigs/quadruped.h"
#include "generator/core/toml.h"

namespace moomill {

// `reader` is at the [builder] table. Refuses unknown keys; does not build.
QuadrupedSpec read_quadruped(TomlReader reader);

// A [[legs]] or [[builder.legs]] table: the joints of a leg, for motion files.
LegSpec read_leg(TomlReader reader);

}  // namespace moomill
