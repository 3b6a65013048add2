#include "neural/kernels/attention.h"
#include "neural/kernels/cpu.h"
#include "neural/kernels/head.h"

namespace moomill {

template <>
const AttentionKernels<float>& attention_kernels<float>(bool bfloat16) {
  if (bfloat16) return attention_bfloat16;
  return used_instruction_set() == InstructionSet::avx512 ? attention_avx512 : attention_avx2;
}
template <>
const AttentionKernels<double>& attention_kernels<double>(bool) {
  return attention_double;
}

template <>
const HeadKernels<float>& head_kernels<float>(bool bfloat16) {
  if (bfloat16) return head_bfloat16;
  return used_instruction_set() == InstructionSet::avx512 ? head_avx512 : head_avx2;
}
template <>
const HeadKernels<double>& head_kernels<double>(bool) {
  return head_double;
}

}  // namespace moomill
