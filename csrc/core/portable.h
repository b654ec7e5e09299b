// The formulas that are compiled for several instruction sets, as the whole program may use them.
#pragma once

#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "core/vectors.h"

#define NMBG_ISA portable
#include "core/lanes.inl"
#include "core/triangle.inl"
#undef NMBG_ISA
