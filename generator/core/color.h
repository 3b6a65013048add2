#pragma once
// Colour as people see it.
#include "generator/core/math.h"

namespace moomill {

// CIE 1976 L*a*b* of a linear Rec. 709 colour, white point D65 (the white of Rec. 709 itself).
dvec3 lab_from_linear(const vec3& rgb);

// CIEDE2000 colour difference of two L*a*b* colours, kL = kC = kH = 1. 1 is just noticeable, 10 plain at a glance.
// Sharma, Wu and Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test data, and
// mathematical observations", Color Research and Application 30 (2005).
double ciede2000(const dvec3& lab1, const dvec3& lab2);

}  // namespace moomill
