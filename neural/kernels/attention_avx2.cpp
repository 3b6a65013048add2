#include "neural/kernels/attention.inl"

namespace moomill {

const AttentionKernels<float> attention_avx2 = Attention<FloatAvx2>::kernels;
const AttentionKernels<double> attention_double = Attention<DoubleAvx2>::kernels;

}  // namespace moomill
