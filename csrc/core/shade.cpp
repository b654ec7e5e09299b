#include "core/shade.h"

#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/check.h"
#include "core/harmonics.h"
#include "core/parallel.h"
#include "core/scatter.h"

namespace nmbg {
namespace {

// Calls body.template operator()<K, B>() for the number of corners and of basis functions at hand.
template <class T, class Body>
void specialise(const Shading<T>& shading, const Body& body) {
    const auto with_basis = [&]<int K>() {
        switch (shading.basis) {
            case 1:
                return body.template operator()<K, 1>();
            case 4:
                return body.template operator()<K, 4>();
            case 9:
                return body.template operator()<K, 9>();
            default:
                throw std::invalid_argument("coeffs: expected 1, 4 or 9 basis functions, got " +
                                            std::to_string(shading.basis));
        }
    };
    if (shading.faces)
        with_basis.template operator()<3>();
    else
        with_basis.template operator()<1>();
}

// Writes the vertices under a pixel; false where it is empty.
template <int K, class T>
bool corners(const Shading<T>& s, int64_t pixel, std::array<int32_t, K>& vertex) {
    const int32_t i = checked("index", s.index[pixel], -1, K == 1 ? s.vertices : s.face_count);
    if (i < 0) return false;
    if constexpr (K == 1)
        vertex[0] = i;
    else
        for (int k = 0; k < K; ++k) vertex[k] = checked("faces", s.faces[K * int64_t{i} + k], 0, s.vertices);
    return true;
}

}  // namespace

template <class T>
void shade(const Shading<T>& s, T* out) {
    specialise(s, [&]<int K, int B>() {
        parallel_blocks(s.pixels, s.threads, [&](int64_t begin, int64_t end) {
            std::vector<T> feature(s.channels);
            for (int64_t pixel = begin; pixel < end; ++pixel) {
                std::fill(feature.begin(), feature.end(), T(0));
                std::array<int32_t, K> vertex{};
                if (corners<K>(s, pixel, vertex)) {
                    T Y[B];
                    harmonics<B>(s.rays + 3 * pixel, Y);
                    for (int k = 0; k < K; ++k) {
                        const T* coeffs = s.coeffs + int64_t{vertex[k]} * B * s.channels;
                        const T weight = s.weight[K * pixel + k];
                        for (int b = 0; b < B; ++b) {
                            const T factor = weight * Y[b];
                            for (int c = 0; c < s.channels; ++c)
                                feature[c] += factor * coeffs[b * s.channels + c];
                        }
                    }
                }
                for (int c = 0; c < s.channels; ++c) out[c * s.pixels + pixel] = feature[c];
            }
        });
    });
}

template <class T>
void shade_backward_coeffs(const Shading<T>& s, const T* grad_out, T* grad_coeffs) {
    specialise(s, [&]<int K, int B>() {
        const auto corners_at = [&](int64_t pixel, std::array<int32_t, K>& vertex) {
            return corners<K>(s, pixel, vertex);
        };
        ordered_scatter<K>(s.pixels, s.vertices, s.threads, corners_at,
                           [&](int64_t pixel, int k, int32_t vertex) {
                               T Y[B];
                               harmonics<B>(s.rays + 3 * pixel, Y);
                               T* grad = grad_coeffs + int64_t{vertex} * B * s.channels;
                               const T weight = s.weight[K * pixel + k];
                               for (int c = 0; c < s.channels; ++c) {
                                   const T g = weight * grad_out[c * s.pixels + pixel];
                                   for (int b = 0; b < B; ++b) grad[b * s.channels + c] += Y[b] * g;
                               }
                           });
    });
}

template <class T>
void shade_backward_pixels(const Shading<T>& s, const T* grad_out, T* grad_weight, T* grad_rays) {
    specialise(s, [&]<int K, int B>() {
        parallel_blocks(s.pixels, s.threads, [&](int64_t begin, int64_t end) {
            for (int64_t pixel = begin; pixel < end; ++pixel) {
                T* grad_w = grad_weight + K * pixel;
                T* grad_ray = grad_rays + 3 * pixel;
                std::array<int32_t, K> vertex{};
                if (!corners<K>(s, pixel, vertex)) {
                    std::fill_n(grad_w, K, T(0));
                    std::fill_n(grad_ray, 3, T(0));
                    continue;
                }
                const T* ray = s.rays + 3 * pixel;
                T Y[B], grad_Y[B] = {};
                harmonics<B>(ray, Y);
                for (int k = 0; k < K; ++k) {
                    const T* coeffs = s.coeffs + int64_t{vertex[k]} * B * s.channels;
                    grad_w[k] = 0;
                    for (int b = 0; b < B; ++b) {
                        T product = 0;
                        for (int c = 0; c < s.channels; ++c)
                            product += grad_out[c * s.pixels + pixel] * coeffs[b * s.channels + c];
                        grad_w[k] += Y[b] * product;
                        grad_Y[b] += s.weight[K * pixel + k] * product;
                    }
                }
                harmonics_backward<B>(ray, grad_Y, grad_ray);
            }
        });
    });
}

template void shade(const Shading<float>&, float*);
template void shade(const Shading<double>&, double*);
template void shade_backward_coeffs(const Shading<float>&, const float*, float*);
template void shade_backward_coeffs(const Shading<double>&, const double*, double*);
template void shade_backward_pixels(const Shading<float>&, const float*, float*, float*);
template void shade_backward_pixels(const Shading<double>&, const double*, double*, double*);

}  // namespace nmbg
