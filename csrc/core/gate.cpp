#include "core/gate.h"

#include <bit>
#include <cmath>

#include "core/bfloat.h"
#include "core/parallel.h"
#include "core/vectors.h"

namespace nmbg {
namespace {

// e^x for x ≤ 0, to two units in the last place; what is not a number stays so. Written out, so that it is
// computed on vectors, and the same on all: x = n ln 2 + r, e^r by its series.
NMBG_INLINE float exp_down(float x) {
    constexpr float rounder = 0x1.8p23f;  // added to a number, its last bits are the nearest whole number
    const float held = x < -87.0f ? -87.0f : x;
    const float rounded = held * 1.44269504f + rounder;
    const float n = rounded - rounder;
    const float r = (held - n * 0.693359375f) + n * 2.12194440e-4f;
    const float series =
        1 + r * (1 + r * (1.0f / 2 + r * (1.0f / 6 + r * (1.0f / 24 + r * (1.0f / 120 + r * (1.0f / 720))))));
    return series * std::bit_cast<float>((std::bit_cast<uint32_t>(rounded) + 127) << 23);
}
NMBG_INLINE double exp_down(double x) { return std::exp(x); }

template <class T>
struct Gate {
    T value, slope;  // ELU and its derivative
    T open;          // sigmoid

    // One comparison a selection: the loops over channels have no branches.
    NMBG_INLINE Gate(T v, T g) {
        const T below = exp_down(v < 0 ? v : T(0));
        value = v < 0 ? below - 1 : v;
        slope = v < 0 ? below : T(1);
        const T far = exp_down(-std::abs(g));
        open = (g < 0 ? far : T(1)) / (1 + far);
    }
};

template <class T>
NMBG_INLINE void forward_any(const T* x, int64_t begin, int64_t end, int channels, T* out) {
    for (int64_t pixel = begin; pixel < end; ++pixel) {
        const T *value = x + 2 * channels * pixel, *opening = value + channels;
        T* to = out + channels * pixel;
#pragma omp simd
        for (int c = 0; c < channels; ++c) {
            const Gate gate(number_of(value[c]), number_of(opening[c]));
            put(gate.value * gate.open, to[c]);
        }
    }
}

template <class T>
NMBG_INLINE void backward_any(const T* x, const T* grad_out, int64_t begin, int64_t end, int channels,
                              T* grad) {
    for (int64_t pixel = begin; pixel < end; ++pixel) {
        const T *value = x + 2 * channels * pixel, *opening = value + channels;
        const T* down = grad_out + channels * pixel;
        T *to_value = grad + 2 * channels * pixel, *to_opening = to_value + channels;
#pragma omp simd
        for (int c = 0; c < channels; ++c) {
            const Gate gate(number_of(value[c]), number_of(opening[c]));
            const auto g = number_of(down[c]);
            put(g * gate.open * gate.slope, to_value[c]);
            put(g * gate.value * (gate.open * (1 - gate.open)), to_opening[c]);
        }
    }
}

NMBG_WIDEST void forward(const float* x, int64_t begin, int64_t end, int channels, float* out) {
    forward_any(x, begin, end, channels, out);
}
NMBG_WIDEST void forward(const Bfloat* x, int64_t begin, int64_t end, int channels, Bfloat* out) {
    forward_any(x, begin, end, channels, out);
}
void forward(const double* x, int64_t begin, int64_t end, int channels, double* out) {
    forward_any(x, begin, end, channels, out);
}
NMBG_WIDEST void backward(const float* x, const float* grad_out, int64_t begin, int64_t end, int channels,
                          float* grad) {
    backward_any(x, grad_out, begin, end, channels, grad);
}
NMBG_WIDEST void backward(const Bfloat* x, const Bfloat* grad_out, int64_t begin, int64_t end, int channels,
                          Bfloat* grad) {
    backward_any(x, grad_out, begin, end, channels, grad);
}
void backward(const double* x, const double* grad_out, int64_t begin, int64_t end, int channels,
              double* grad) {
    backward_any(x, grad_out, begin, end, channels, grad);
}

}  // namespace

template <class T>
void gate(const T* x, int64_t pixels, int channels, int threads, T* out) {
    parallel_blocks(pixels, threads,
                    [&](int64_t begin, int64_t end) { forward(x, begin, end, channels, out); });
}

template <class T>
void gate_backward(const T* x, const T* grad_out, int64_t pixels, int channels, int threads, T* grad) {
    parallel_blocks(pixels, threads,
                    [&](int64_t begin, int64_t end) { backward(x, grad_out, begin, end, channels, grad); });
}

template void gate(const float*, int64_t, int, int, float*);
template void gate(const double*, int64_t, int, int, double*);
template void gate(const Bfloat*, int64_t, int, int, Bfloat*);
template void gate_backward(const float*, const float*, int64_t, int, int, float*);
template void gate_backward(const double*, const double*, int64_t, int, int, double*);
template void gate_backward(const Bfloat*, const Bfloat*, int64_t, int, int, Bfloat*);

}  // namespace nmbg
