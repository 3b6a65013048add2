#include "neural/kernels/cpu.h"

namespace moomill {

InstructionSet best_instruction_set() {
  static const bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                             __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  return avx512 ? InstructionSet::avx512 : InstructionSet::avx2;
}

bool cpu_has_bfloat16() {
  return best_instruction_set() == InstructionSet::avx512 && __builtin_cpu_supports("avx512bf16");
}

}  // namespace moomill
