#include "core/blend_photos.h"

#include <algorithm>
#include <bit>
#include <type_traits>
#include <vector>

#include "core/dual.h"
#include "core/mixture.h"
#include "core/parallel.h"
#include "core/vectors.h"

namespace nmbg {
namespace {

// Pixels that are blended together.
constexpr int strip_pixels = 128;

// From the best score down: 2 · source, + 1 where only some of the pixels around show the surface; or -1.
using Ranks = int32_t[most_sources + 1][strip_pixels];

// Room for the places of a strip, sorted by what they show.
struct SortedPlaces {
    std::vector<int32_t> end;  // of the places of rank -1, 0, 1, …
    int32_t sorted[most_sources * strip_pixels];

    explicit SortedPlaces(std::size_t sources) : end(2 * sources + 1) {}

    void sort(const Ranks& ranks, int keep) {
        std::fill(end.begin(), end.end(), 0);
        // Pixel by pixel, whose sources differ: a counter is seldom raised twice in a row.
        for (int i = 0; i < strip_pixels; ++i)
            for (int k = 0; k < keep; ++k) ++end[ranks[k][i] + 1];
        int32_t start = 0;
        for (int32_t& e : end) {
            const int32_t n = e;
            e = start, start += n;
        }
        for (int i = 0; i < strip_pixels; ++i)
            for (int k = 0; k < keep; ++k) sorted[end[ranks[k][i] + 1]++] = k * strip_pixels + i;
    }
};

}  // namespace
}  // namespace nmbg

#define NMBG_FILE "core/blend_strip.inl"
#include "core/each_isa.h"

namespace nmbg {
namespace {

template <class Texel>
void blend_strip(const Blending<float, Texel>& b, int64_t first, SortedPlaces& places,
                 const BlendResult<float>& out) {
    NMBG_DISPATCH(blend_strip(b, first, places, out));
}
template <class Texel>
void blend_strip(const Blending<double, Texel>& b, int64_t first, SortedPlaces& places,
                 const BlendResult<double>& out) {
    portable::blend_strip(b, first, places, out);
}

}  // namespace

template <class T, class Texel>
void blend_photos(const Blending<T, Texel>& b, const BlendResult<T>& out) {
    parallel_blocks(int64_t{b.height} * b.width, b.threads, [&](int64_t begin, int64_t end) {
        SortedPlaces places(b.photos.size());
        for (int64_t first = begin; first < end; first += strip_pixels) blend_strip(b, first, places, out);
    });
}

template void blend_photos(const Blending<float, uint8_t>&, const BlendResult<float>&);
template void blend_photos(const Blending<float, float>&, const BlendResult<float>&);
template void blend_photos(const Blending<double, uint8_t>&, const BlendResult<double>&);
template void blend_photos(const Blending<double, double>&, const BlendResult<double>&);

}  // namespace nmbg
