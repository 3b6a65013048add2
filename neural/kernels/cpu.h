#pragma once
// What this processor can do.
namespace moomill {

enum class InstructionSet { avx2, avx512 };
InstructionSet best_instruction_set();  // AVX-512 needs F, BW, DQ and VL
bool cpu_has_bfloat16();                // AVX512-BF16

}  // namespace moomill
