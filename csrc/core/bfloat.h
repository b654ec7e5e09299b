// Numbers of 16 bits: the upper half of a float.
#pragma once

#include <bit>
#include <cstdint>

#include "core/vectors.h"

namespace nmbg {

struct Bfloat {
    uint16_t bits;
};

// The numbers that formulas work with, and back to what is stored.
NMBG_INLINE float number_of(Bfloat x) { return std::bit_cast<float>(uint32_t{x.bits} << 16); }
NMBG_INLINE float number_of(float x) { return x; }
NMBG_INLINE double number_of(double x) { return x; }

NMBG_INLINE void put(float x, float& to) { to = x; }
NMBG_INLINE void put(double x, double& to) { to = x; }
// To the nearest, of two the even one; what is not a number stays so.
NMBG_INLINE void put(float x, Bfloat& to) {
    const auto bits = std::bit_cast<uint32_t>(x);
    const uint32_t rounded = (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
    to.bits = static_cast<uint16_t>(x == x ? rounded : 0x7fc0);
}

}  // namespace nmbg
