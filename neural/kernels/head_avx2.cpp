#include "neural/kernels/head.inl"

namespace moomill {

const HeadKernels<float> head_avx2 = Head<FullFormat<FloatAvx2>>::kernels;
const HeadKernels<double> head_double = Head<FullFormat<DoubleAvx2>>::kernels;

}  // namespace moomill
