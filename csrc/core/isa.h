// Which instruction set this process uses.
#pragma once

namespace nmbg {

enum class Isa { portable, avx2, avx512 };

// The widest that the processor has; the environment variable NMBG_SIMD (portable, avx2 or avx512) can ask
// for less. Decided at the first call.
Isa isa();

const char* name_of(Isa isa);

}  // namespace nmbg
