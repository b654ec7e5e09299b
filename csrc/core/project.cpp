#include "core/project.h"

#include "core/parallel.h"
#include "core/portable.h"

namespace nmbg {
namespace {

template <class T>
NMBG_INLINE void project_any(const double* P, const T* points, int64_t n, T* h) {
#pragma omp simd
    for (int64_t i = 0; i < n; ++i) {
        const double x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
        h[3 * i] = static_cast<T>(P[3] + P[0] * x + P[1] * y + P[2] * z);
        h[3 * i + 1] = static_cast<T>(P[7] + P[4] * x + P[5] * y + P[6] * z);
        h[3 * i + 2] = static_cast<T>(P[11] + P[8] * x + P[9] * y + P[10] * z);
    }
}

NMBG_WIDEST void project(const double* P, const float* points, int64_t n, float* h) {
    project_any(P, points, n, h);
}
void project(const double* P, const double* points, int64_t n, double* h) { project_any(P, points, n, h); }

}  // namespace

template <class T>
void project_points(const double* P, const T* points, int64_t n, int threads, T* h) {
    parallel_blocks(n, threads, [&](int64_t begin, int64_t end) {
        project(P, points + 3 * begin, end - begin, h + 3 * begin);
    });
}

template void project_points(const double*, const float*, int64_t, int, float*);
template void project_points(const double*, const double*, int64_t, int, double*);

}  // namespace nmbg
