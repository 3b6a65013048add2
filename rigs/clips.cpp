#include "rigs/clips.h"

namespace moomill {

std::vector<Clip> build_clips(const QuadrupedSpec&, const Rig&) { return {}; }

}  // namespace moomill
