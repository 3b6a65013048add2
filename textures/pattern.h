#pragma once
// The layers of a procedural coat, for the baker, which fades part colours itself. Internal to textures/.
#include "textures/coat.h"

namespace moomill {

vec3 coat_color_without_parts(const ProceduralCoat& coat, const dvec3& neutral);  // linear, not yet clamped
float fur_shade(const ProceduralCoat& coat, const dvec3& neutral);                // factor on every colour
bool part_has_color(const PartColor& color, const std::string& part);

}  // namespace moomill
