#include "neural/kernels/attention.inl"

namespace moomill {

const AttentionKernels<float> attention_avx512 = Attention<FloatAvx512>::kernels;

}  // namespace moomill
