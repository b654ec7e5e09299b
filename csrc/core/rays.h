// Pixels → directions in the world.
#pragma once

#include <cstdint>

namespace nmbg {

// M [3, 3] row by row, of homogeneous pixels → out [height, width, 3]: unit vectors along M (x + ½, y + ½,
// 1). T is float or double; what a row or a column shares is computed in double and rounded.
template <class T>
void pixel_rays(const double* M, int64_t height, int64_t width, int threads, T* out);

}  // namespace nmbg
