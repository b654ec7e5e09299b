// Photographs blended over a surface: each pixel shows what the sources that see its surface point best show.
#pragma once

#include <cstdint>
#include <vector>

namespace nmbg {

// A source. T is float or double; Texel is uint8_t, of which 255 means 1, or T.
template <class T, class Texel>
struct Photo {
    const Texel* texels;    // mip chain: per level, finest first, [height, width, 4]; the fourth is not read
    const T* depth;         // [height, width] view-space z of the surface, 0 where none may be shown
    int32_t height, width;  // of the finest level
    const T* warp;  // [3, 4] = [B | c]: pixel (x, y) of the new view at depth z → z B (x, y, 1) + c here
    const T* intrinsics;  // [3, 3], upper triangular
};

// How well a source sees a point: a product of factors in [0, 1], continuous in the point and the cameras.
template <class T>
struct BlendRule {
    int keep;     // sources blended in a pixel, 1 to most_sources
    T angle;      // radians between the two rays at which the score has fallen to a sixteenth
    T tolerance;  // visible up to this relative difference of depths, not at all from twice as much on
    T border;     // px along a photograph's border over which the score rises
};

constexpr int most_sources = 15;

// The problem.
template <class T, class Texel>
struct Blending {
    const T* depth;         // [height, width] view-space z of the new view, 0 where it sees nothing
    int32_t height, width;  // of the new view
    T focal;                // of the new view, px
    std::vector<Photo<T, Texel>> photos;
    BlendRule<T> rule;
    int threads;
};

// depth → surface point → per source: projection, visibility by the source's own depth, score → the `keep`
// best, each weighted by what its score exceeds the next one's → colours, from the mip level that fits.
//   colour [3, height, width]: 0 where no source sees the point
//   weight [height, width]: the best score, in [0, 1]
//   variance [height, width]: of the blended colours, mean over the channels
//   sources [height, width, keep + 1]: from the best score down, or -1; the last one only sets the weights
//   weights [keep, height, width]: sum to 1, or are 0
//   shown [keep, 3, height, width]: the colours that the weights mix, 0 where there is none
// The last three may be null: not wanted.
template <class T>
struct BlendResult {
    T *colour, *weight, *variance;
    int32_t* sources;
    T *weights, *shown;
};

template <class T, class Texel>
void blend_photos(const Blending<T, Texel>& blending, const BlendResult<T>& out);

// What comes down to the outputs.
template <class T>
struct BlendGradient {
    const T* colour;    // [3, height, width]
    const T* weight;    // [height, width]
    const T* variance;  // [height, width]
};

// sources, as the forward pass chose them → grad_depth [height, width], grad_warps [photos, 3, 4].
template <class T, class Texel>
void blend_photos_backward(const Blending<T, Texel>& blending, const int32_t* sources,
                           const BlendGradient<T>& grad, T* grad_depth, T* grad_warps);

// The same → a mip chain per photo, which comes zeroed.
template <class T>
void blend_photos_backward_texels(const Blending<T, T>& blending, const int32_t* sources,
                                  const BlendGradient<T>& grad, const std::vector<T*>& grad_texels);

// Texels of a mip chain [height, width]: sizes are halved, rounded up, down to 1 × 1.
inline int64_t mip_texels(int64_t height, int64_t width) {
    int64_t total = height * width;
    while (height > 1 || width > 1) {
        height = (height + 1) / 2, width = (width + 1) / 2;
        total += height * width;
    }
    return total;
}

}  // namespace nmbg
