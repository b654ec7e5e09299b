#include "core/adam_rows.h"

#include <cmath>
#include <stdexcept>
#include <string>

#include "core/parallel.h"
#include "core/vectors.h"

namespace nmbg {
namespace {

template <class T>
NMBG_INLINE void step_any(const AdamRows<T>& adam, int64_t begin, int64_t end) {
    const auto beta1 = static_cast<T>(adam.beta1), beta2 = static_cast<T>(adam.beta2);
    const auto new1 = static_cast<T>(1 - adam.beta1), new2 = static_cast<T>(1 - adam.beta2);
    const auto eps = static_cast<T>(adam.eps), rate = static_cast<T>(adam.rate);
    const int64_t width = adam.width;
    for (int64_t row = begin; row < end; ++row) {
        const T* g = adam.grad + row * width;
        T* x = adam.table + adam.index[row] * width;
        T* m = adam.mean + adam.index[row] * width;
        T* v = adam.square + adam.index[row] * width;
#pragma omp simd
        for (int64_t i = 0; i < width; ++i) {
            const T mean = beta1 * m[i] + new1 * g[i], square = beta2 * v[i] + new2 * (g[i] * g[i]);
            m[i] = mean, v[i] = square;
            x[i] -= rate * mean / (std::sqrt(square) + eps);
        }
    }
}

NMBG_WIDEST void step(const AdamRows<float>& adam, int64_t begin, int64_t end) { step_any(adam, begin, end); }
void step(const AdamRows<double>& adam, int64_t begin, int64_t end) { step_any(adam, begin, end); }

}  // namespace

template <class T>
void adam_rows(const AdamRows<T>& adam) {
    for (int64_t row = 0; row < adam.rows; ++row)
        if (adam.index[row] < 0 || adam.index[row] >= adam.all)
            throw std::invalid_argument("index: expected rows from 0 to " + std::to_string(adam.all - 1) +
                                        ", got " + std::to_string(adam.index[row]));
    parallel_blocks(adam.rows, adam.threads, [&](int64_t begin, int64_t end) { step(adam, begin, end); });
}

template void adam_rows(const AdamRows<float>&);
template void adam_rows(const AdamRows<double>&);

}  // namespace nmbg
