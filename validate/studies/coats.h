#pragma once
// Do the coats of a species look as different as they should? CIEDE2000, averaged over the animal's surface.
#include <string>
#include <vector>

#include "validate/studies/study.h"

namespace moomill {

struct CoatPair {
  int first = 0, second = 0;     // coat indices
  double mean = 0, median = 0;   // CIEDE2000 over the surface, by area
  double share_above_20 = 0;     // of the surface
  bool meant_alike = false;      // one of them says that it looks like the other
};

struct CoatComparison {
  std::vector<std::string> names;
  std::vector<CoatPair> pairs;  // all, in the order (0, 1), (0, 2), ...
};

// Every pair of the coats, by names or paths as in scenes; those that wear the rig's own materials are an InputError.
CoatComparison compare_coats(const std::string& species, const std::vector<std::string>& coats);

// The coats that ship for a species. Bounds: 2 to 6 for a pair meant to look alike, above 10 for any other.
StudyResult coat_study(const std::string& species);

}  // namespace moomill
