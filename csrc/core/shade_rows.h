// Sums over the rows of coefficients, basis × channels numbers each, of the vertices under a pixel.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/check.h"
#include "core/portable.h"
#include "core/shade.h"

namespace nmbg {

// Writes the vertices under a pixel; false where it is empty.
template <int K, class T>
NMBG_INLINE bool corners(const Shading<T>& s, int64_t pixel, std::array<int32_t, K>& vertex) {
    const int32_t i = checked("index", s.index[pixel], -1, K == 1 ? s.vertices : s.face_count);
    if (i < 0) return false;
    if constexpr (K == 1)
        vertex[0] = i;
    else
        for (int k = 0; k < K; ++k) vertex[k] = checked("faces", s.faces[K * int64_t{i} + k], 0, s.vertices);
    return true;
}

// shade() of the pixels [begin, end).
template <int K, int B, class T>
void shade_pixels(const Shading<T>& s, int64_t begin, int64_t end, T* out);

// Adds what some pixels, in their order, give to the coefficients of the vertices [first, end); grad
// [pixels, channels].
template <int K, int B, class T>
void add_pixels(const Shading<T>& s, const T* grad, std::span<const int32_t> pixels, int64_t first,
                int64_t end, T* grad_coeffs);

}  // namespace nmbg
