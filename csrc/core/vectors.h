// Loops over many elements at a time, on whatever vectors the processor has.
#pragma once

// One binary for all x86-64: the loader picks the widest vectors that the processor has.
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define NMBG_WIDEST __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define NMBG_WIDEST
#endif

// Into every clone: what is not inlined is compiled once, for the narrowest.
#if defined(__GNUC__)
#define NMBG_INLINE inline __attribute__((always_inline))
#define NMBG_INLINE_LAMBDA __attribute__((always_inline))
#else
#define NMBG_INLINE inline
#define NMBG_INLINE_LAMBDA
#endif
