#pragma once
// How the kernels lay out matrices and scratch memory.
#include <cstddef>

namespace moomill {

// Rows this far apart do not all fall into the same few sets of the cache.
inline constexpr int padded_row(int columns) {
  return columns + 16;
}

}  // namespace moomill
