#include "core/shade.h"

#include <algorithm>
#include <array>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>

#include "core/harmonics.h"
#include "core/parallel.h"
#include "core/scatter.h"
#include "core/shade_rows.h"

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

}  // namespace

template <class T>
void shade(const Shading<T>& s, T* out) {
    specialise(s, [&]<int K, int B>() {
        parallel_blocks(s.pixels, s.threads,
                        [&](int64_t begin, int64_t end) { shade_pixels<K, B>(s, begin, end, out); });
    });
}

template <class T>
void shade_backward_coeffs(const Shading<T>& s, const T* grad_out, T* grad_coeffs) {
    const int64_t size = int64_t{s.basis} * s.channels;
    // The channels of a pixel next to each other, as they are needed.
    const auto grad = std::make_unique_for_overwrite<T[]>(s.pixels * s.channels);
    parallel_blocks(s.pixels, s.threads, [&](int64_t begin, int64_t end) {
        for (int64_t pixel = begin; pixel < end; ++pixel)
            for (int c = 0; c < s.channels; ++c)
                grad[pixel * s.channels + c] = grad_out[c * s.pixels + pixel];
    });
    specialise(s, [&]<int K, int B>() {
        const auto corners_at = [&](int64_t pixel, std::array<int32_t, K>& vertex) {
            return corners<K>(s, pixel, vertex);
        };
        scatter_by_owner<K>(s.pixels, s.vertices, s.threads, corners_at,
                            [&](std::span<const int32_t> pixels, int64_t first, int64_t end) {
                                // Here, where they stay in the cache for the sums.
                                std::fill(grad_coeffs + first * size, grad_coeffs + end * size, T(0));
                                add_pixels<K, B>(s, grad.get(), pixels, first, end, grad_coeffs);
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
