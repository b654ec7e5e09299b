// Features of pixels: descriptors of the vertices under a pixel, looked up along its viewing ray.
#pragma once

#include <cstdint>

namespace nmbg {

// The problem. T is float or double. A pixel has K corners with a weight each: one point (K = 1, `faces`
// null) or the three vertices of a face (K = 3, weights are barycentrics).
//   feature_c(pixel) = Σ_k weight_k Σ_b Y_b(ray) coeffs[vertex_k, b, c]
template <class T>
struct Shading {
    const int32_t* index;  // [pixels] point or face, or -1 for an empty pixel
    const T* weight;       // [pixels, K]
    const int32_t* faces;  // [face_count, 3], or null for points
    const T* rays;         // [pixels, 3] unit directions
    const T* coeffs;       // [vertices, basis, channels]
    int64_t pixels;
    int64_t face_count;
    int64_t vertices;
    int basis;  // 1, 4 or 9
    int channels;
    int threads;
};

// All three throw std::invalid_argument where a pixel leads outside of a table.

// out [channels, pixels]: the features, 0 where empty.
template <class T>
void shade(const Shading<T>& shading, T* out);

// grad_out [channels, pixels] → grad_coeffs [vertices, basis, channels].
// Does not read shading.coeffs.
template <class T>
void shade_backward_coeffs(const Shading<T>& shading, const T* grad_out, T* grad_coeffs);

// grad_out [channels, pixels] → grad_weight [pixels, K] and grad_rays [pixels, 3].
template <class T>
void shade_backward_pixels(const Shading<T>& shading, const T* grad_out, T* grad_weight, T* grad_rays);

}  // namespace nmbg
