#include "neural/kernels/head.inl"

namespace moomill {

const HeadKernels<float> head_avx512 = Head<FloatAvx512>::kernels;

}  // namespace moomill
