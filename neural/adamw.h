#pragma once
// AdamW (Loshchilov and Hutter, 2019) in one pass over the parameters; torch::optim::AdamW makes a dozen, which at full
// size costs a sixth of a step.
#include <torch/torch.h>

namespace moomill {

// What optimiser.step() does, on the optimiser's own options and state (so saving and loading stay as they are): float
// parameters on the CPU; others, and amsgrad, are left to LibTorch. The same bits for any number of threads.
void adamw_step(torch::optim::AdamW& optimiser);

}  // namespace moomill
