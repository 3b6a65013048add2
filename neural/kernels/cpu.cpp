#include "neural/kernels/cpu.h"

#include <atomic>

namespace moomill {

namespace {

std::atomic<InstructionSet> most_allowed{InstructionSet::avx512};

}  // namespace

InstructionSet best_instruction_set() {
  static const bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                             __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  return avx512 ? InstructionSet::avx512 : InstructionSet::avx2;
}

bool cpu_has_bfloat16() {
  return used_instruction_set() == InstructionSet::avx512 && __builtin_cpu_supports("avx512bf16");
}

InstructionSet used_instruction_set() {
  return most_allowed == InstructionSet::avx2 ? InstructionSet::avx2 : best_instruction_set();
}

void limit_instruction_set(InstructionSet most) {
  most_allowed = most;
}

}  // namespace moomill
