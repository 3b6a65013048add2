#pragma once
// What this processor can do, and which kernels are used.
namespace moomill {

enum class InstructionSet { avx2, avx512 };
InstructionSet best_instruction_set();  // AVX-512 needs F, BW, DQ and VL
bool cpu_has_bfloat16();                // AVX512-BF16

// The set the kernels use: the best one, or a lesser one after limit_instruction_set (for tests and benchmarks; not to
// be called while an operator runs).
InstructionSet used_instruction_set();
void limit_instruction_set(InstructionSet most);

}  // namespace moomill
