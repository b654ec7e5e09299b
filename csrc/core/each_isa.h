// Compiles the file NMBG_FILE for each instruction set, into namespaces portable, avx2 and avx512 of nmbg:
// one binary for all x86-64. To be included once, after all other headers.
#include "core/isa.h"
#include "core/places.h"
#include "core/portable.h"
#include "core/runs.h"

#define NMBG_ISA portable
#include "core/places.inl"
#include "core/runs.inl"
#include NMBG_FILE
#undef NMBG_ISA

#if defined(__x86_64__) && defined(__GNUC__)

#include <immintrin.h>

#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC push_options
#pragma GCC target("avx2")
#endif
#define NMBG_AVX2
#define NMBG_ISA avx2
#include "core/lanes.inl"
#include "core/places.inl"
#include "core/runs.inl"
#include "core/triangle.inl"
#include NMBG_FILE
#undef NMBG_ISA
#ifdef __clang__
#pragma clang attribute pop
#pragma clang attribute push(__attribute__((target("avx512f,avx512vl,avx512bw,avx512dq"))), \
                             apply_to = function)
#else
#pragma GCC pop_options
#pragma GCC push_options
#pragma GCC target("avx512f,avx512vl,avx512bw,avx512dq")
#endif
#define NMBG_AVX512
#define NMBG_ISA avx512
#include "core/lanes.inl"
#include "core/places.inl"
#include "core/runs.inl"
#include "core/triangle.inl"
#include NMBG_FILE
#undef NMBG_ISA
#undef NMBG_AVX2
#undef NMBG_AVX512
#ifdef __clang__
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif

// Returns what the call gives, compiled for the instruction set in use.
#define NMBG_DISPATCH(...)                \
    switch (isa()) {                      \
        case Isa::avx512:                 \
            return avx512::__VA_ARGS__;   \
        case Isa::avx2:                   \
            return avx2::__VA_ARGS__;     \
        default:                          \
            return portable::__VA_ARGS__; \
    }

#else

#define NMBG_DISPATCH(...) return portable::__VA_ARGS__

#endif
