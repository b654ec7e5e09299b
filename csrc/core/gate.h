// Gated features: ELU of one half of the channels times the sigmoid of the other.
#pragma once

#include <cstdint>

namespace nmbg {

// T: float, double, or Bfloat, of which each number is computed in float and rounded once.

// x [pixels, 2 channels], values before gates → out [pixels, channels] = elu(value) · sigmoid(gate).
template <class T>
void gate(const T* x, int64_t pixels, int channels, int threads, T* out);

// grad_out [pixels, channels] → grad [pixels, 2 channels].
template <class T>
void gate_backward(const T* x, const T* grad_out, int64_t pixels, int channels, int threads, T* grad);

}  // namespace nmbg
