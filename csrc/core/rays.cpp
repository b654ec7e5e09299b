#include "core/rays.h"

#include <cmath>
#include <vector>

#include "core/parallel.h"
#include "core/portable.h"

namespace nmbg {
namespace {

template <class T>
NMBG_INLINE void row_any(const T* start, const T* columns, int64_t width, T* out) {
#pragma omp simd
    for (int64_t i = 0; i < width; ++i) {
        const T x = start[0] + columns[3 * i], y = start[1] + columns[3 * i + 1],
                z = start[2] + columns[3 * i + 2];
        const T norm = std::sqrt(x * x + y * y + z * z);
        out[3 * i] = x / norm, out[3 * i + 1] = y / norm, out[3 * i + 2] = z / norm;
    }
}

NMBG_WIDEST void row(const float* start, const float* columns, int64_t width, float* out) {
    row_any(start, columns, width, out);
}
void row(const double* start, const double* columns, int64_t width, double* out) {
    row_any(start, columns, width, out);
}

}  // namespace

template <class T>
void pixel_rays(const double* M, int64_t height, int64_t width, int threads, T* out) {
    std::vector<T> columns(3 * width);
    for (int64_t i = 0; i < width; ++i)
        for (int c = 0; c < 3; ++c)
            columns[3 * i + c] = static_cast<T>((static_cast<double>(i) + 0.5) * M[3 * c]);
    parallel_blocks(height, threads, [&](int64_t begin, int64_t end) {
        for (int64_t y = begin; y < end; ++y) {
            T start[3];
            for (int c = 0; c < 3; ++c)
                start[c] = static_cast<T>(M[3 * c + 2] + (static_cast<double>(y) + 0.5) * M[3 * c + 1]);
            row(start, columns.data(), width, out + 3 * width * y);
        }
    });
}

template void pixel_rays(const double*, int64_t, int64_t, int, float*);
template void pixel_rays(const double*, int64_t, int64_t, int, double*);

}  // namespace nmbg
