// Points of the world → homogeneous pixels.
#pragma once

#include <cstdint>

namespace nmbg {

// P [3, 4] row by row, points [n, 3] → h [n, 3]. T is float or double; summed in double, p₃ + p₀ x + p₁ y +
// p₂ z from the left, and rounded once.
template <class T>
void project_points(const double* P, const T* points, int64_t n, int threads, T* h);

}  // namespace nmbg
