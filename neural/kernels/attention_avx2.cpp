#include "neural/kernels/attention.inl"

namespace moomill {

const AttentionKernels<float> attention_avx2 = Attention<FullFormat<FloatAvx2>>::kernels;
const AttentionKernels<double> attention_double = Attention<FullFormat<DoubleAvx2>>::kernels;

}  // namespace moomill
