#include "core/shade_rows.h"

#include <type_traits>
#include <vector>

#include "core/harmonics.h"

#define NMBG_FILE "core/shade_rows.inl"
#include "core/each_isa.h"

namespace nmbg {
namespace {

template <int K, int B>
void pixels_of_floats(const Shading<float>& s, int64_t begin, int64_t end, float* out) {
    NMBG_DISPATCH(shade_pixels<K, B>(s, begin, end, out));
}

template <int K, int B>
void add_floats(const Shading<float>& s, const float* grad, std::span<const int32_t> pixels, int64_t first,
                int64_t end, float* grad_coeffs) {
    NMBG_DISPATCH(add_pixels<K, B>(s, grad, pixels, first, end, grad_coeffs));
}

}  // namespace

template <int K, int B, class T>
void shade_pixels(const Shading<T>& s, int64_t begin, int64_t end, T* out) {
    if constexpr (std::is_same_v<T, float>)
        pixels_of_floats<K, B>(s, begin, end, out);
    else
        portable::shade_any_pixels<K, B>(s, begin, end, out);
}

template <int K, int B, class T>
void add_pixels(const Shading<T>& s, const T* grad, std::span<const int32_t> pixels, int64_t first,
                int64_t end, T* grad_coeffs) {
    if constexpr (std::is_same_v<T, float>)
        add_floats<K, B>(s, grad, pixels, first, end, grad_coeffs);
    else
        portable::add_any_pixels<K, B>(s, grad, pixels, first, end, grad_coeffs);
}

#define NMBG_INSTANTIATE(K, B, T)                                                                     \
    template void shade_pixels<K, B, T>(const Shading<T>&, int64_t, int64_t, T*);                     \
    template void add_pixels<K, B, T>(const Shading<T>&, const T*, std::span<const int32_t>, int64_t, \
                                      int64_t, T*);
#define NMBG_INSTANTIATE_ALL(K, B) NMBG_INSTANTIATE(K, B, float) NMBG_INSTANTIATE(K, B, double)
NMBG_INSTANTIATE_ALL(1, 1)
NMBG_INSTANTIATE_ALL(1, 4)
NMBG_INSTANTIATE_ALL(1, 9)
NMBG_INSTANTIATE_ALL(3, 1)
NMBG_INSTANTIATE_ALL(3, 4)
NMBG_INSTANTIATE_ALL(3, 9)

}  // namespace nmbg
