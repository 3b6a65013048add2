#include "neural/kernels/head.inl"

namespace moomill {

const HeadKernels<float> head_avx512 = Head<FullFormat<FloatAvx512>>::kernels;
const HeadKernels<float> head_bfloat16 = Head<HalfFormat>::kernels;

}  // namespace moomill
