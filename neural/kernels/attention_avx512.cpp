#include "neural/kernels/attention.inl"

namespace moomill {

const AttentionKernels<float> attention_avx512 = Attention<FullFormat<FloatAvx512>>::kernels;
const AttentionKernels<float> attention_bfloat16 = Attention<HalfFormat>::kernels;

}  // namespace moomill
