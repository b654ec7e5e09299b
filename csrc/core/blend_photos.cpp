#include "core/blend_photos.h"

#include <algorithm>
#include <vector>

#include "core/mixture.h"
#include "core/parallel.h"
#include "core/photo_sight.h"
#include "core/vectors.h"

namespace nmbg {
namespace {

// Pixels that are blended together.
constexpr int strip_pixels = 8 * lanes;

// Pixels that follow one another in the new view; where it ends, pixels that see nothing.
template <class T>
struct Strip {
    int64_t first;
    int pixels;
    T x[strip_pixels], y[strip_pixels], z[strip_pixels];

    template <class Texel>
    NMBG_INLINE Strip(const Blending<T, Texel>& b, int64_t start)
        : first(start),
          pixels(static_cast<int>(std::min<int64_t>(strip_pixels, int64_t{b.height} * b.width - start))) {
        T row = T(first / b.width) + T(0.5), column = T(first % b.width) + T(0.5);
        for (int i = 0; i < strip_pixels; ++i) {
            x[i] = column, y[i] = row;
            z[i] = i < pixels ? usable(b.depth[first + i]) : T(0);
            column += 1;
            if (column > b.width) column = T(0.5), row += 1;
        }
    }
};

template <class T>
using StripMixture = Mixture<T, strip_pixels>;
using Ranks = int32_t[most_sources + 1][strip_pixels];  // sources from the best score down, or -1

// Let a source compete for pixels [i0, i0 + lanes).
template <class T, class Texel>
NMBG_INLINE void rank(const Photo<T, Texel>& photo, int32_t s, const BlendRule<T>& rule, T focal,
                      const Strip<T>& strip, int i0, StripMixture<T>& best, Ranks& sources) {
    T u[lanes], v[lanes], z[lanes], score[lanes];
    int hopeful = 0;
#pragma omp simd reduction(| : hopeful)
    for (int i = 0; i < lanes; ++i) {
        const T depth = strip.z[i0 + i];
        const Sight<T> sight =
            look<T>(photo, rule, focal, depth, warped(photo.warp, strip.x[i0 + i], strip.y[i0 + i], depth));
        u[i] = sight.u, v[i] = sight.v, z[i] = sight.z, score[i] = sight.score;
        hopeful |= sight.score > best.score[rule.keep][i0 + i];
    }
    if (!hopeful) return;
#pragma omp simd
    for (int i = 0; i < lanes; ++i)
        score[i] *= sum(seen(photo, rule, Footprint<T>(u[i], v[i], photo.width, photo.height), z[i]));
    int32_t id[lanes];
    for (int i = 0; i < lanes; ++i) id[i] = s;
    for (int k = 0; k <= rule.keep; ++k) {
#pragma omp simd
        for (int i = 0; i < lanes; ++i) {
            T& best_score = best.score[k][i0 + i];
            int32_t& best_source = sources[k][i0 + i];
            // What was moved down moves down the rest: equal scores stay in the order of their sources.
            const bool better = (score[i] > best_score) | (id[i] != s);
            const T old_score = best_score;
            const int32_t old_source = best_source;
            best_score = better ? score[i] : old_score;
            best_source = better ? id[i] : old_source;
            score[i] = better ? old_score : score[i];
            id[i] = better ? old_source : id[i];
        }
    }
}

// The weighted sum of four texels.
template <class T, class Texel>
NMBG_INLINE Rgb<T> filtered(const Texel* texels, const Footprint<T>& four, Four<T> weight) {
    return (weight.a * texel<T>(texels, four.offset(0)) + weight.b * texel<T>(texels, four.offset(1))) +
           (weight.c * texel<T>(texels, four.offset(2)) + weight.d * texel<T>(texels, four.offset(3)));
}

// The colours that a source shows in some of a strip's pixels: place k · strip_pixels + i is of rank k in
// pixel i.
template <class T, class Texel>
NMBG_INLINE void show(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, const Strip<T>& strip,
                      const int32_t (&places)[lanes], StripMixture<T>& mixture) {
    T u[lanes], v[lanes], z[lanes], level[lanes];
    T red[lanes], green[lanes], blue[lanes];
    T finest = 0;
#pragma omp simd reduction(max : finest)
    for (int i = 0; i < lanes; ++i) {
        const int pixel = places[i] % strip_pixels;
        const T depth = strip.z[pixel];
        const Sight<T> sight =
            look<T>(photo, rule, focal, depth, warped(photo.warp, strip.x[pixel], strip.y[pixel], depth));
        u[i] = sight.u, v[i] = sight.v, z[i] = sight.z, level[i] = sight.finer;
        finest = sight.finer > finest ? sight.finer : finest;
    }
    T coarsest = 0;
    if (finest > T(1))
        for (int i = 0; i < lanes; ++i) {
            level[i] = level_for(level[i]);
            coarsest = std::max(coarsest, level[i]);
        }
    else
        for (int i = 0; i < lanes; ++i) level[i] = 0;
    MipLevel mip{photo.height, photo.width};
    const bool single = mip.last();
#pragma omp simd
    for (int i = 0; i < lanes; ++i) {
        const Footprint<T> four(u[i], v[i], photo.width, photo.height);
        const Rgb<T> colour = filtered(photo.texels, four, finest_weights(photo, rule, four, z[i]));
        const T share = share_of(T(0), single, level[i]);
        red[i] = share * colour.red, green[i] = share * colour.green, blue[i] = share * colour.blue;
    }
    T scale = 1;
    while (coarsest > T(mip.index) && !mip.last()) {
        mip = mip.next();
        scale /= 2;
        const Texel* texels = photo.texels + 4 * mip.first;
        const int32_t height = mip.height, width = mip.width;
        const T index = T(mip.index);
        const bool last = mip.last();
#pragma omp simd
        for (int i = 0; i < lanes; ++i) {
            const Footprint<T> four(scale * u[i], scale * v[i], width, height);
            const Rgb<T> colour = filtered(texels, four, four.weights());
            const T share = share_of(index, last, level[i]);
            red[i] += share * colour.red, green[i] += share * colour.green, blue[i] += share * colour.blue;
        }
    }
    constexpr T unit = 1 / one<T, Texel>;
    for (int i = 0; i < lanes; ++i) {
        const int k = places[i] / strip_pixels, pixel = places[i] % strip_pixels;
        mixture.shown[k][0][pixel] = unit * red[i];
        mixture.shown[k][1][pixel] = unit * green[i];
        mixture.shown[k][2][pixel] = unit * blue[i];
    }
}

// A source as the loops over pixels take it: copies, of which the compiler knows that nothing writes to them.
template <class T, class Texel>
struct Source {
    T warp[12], intrinsics[9];
    Photo<T, Texel> photo;

    NMBG_INLINE explicit Source(const Photo<T, Texel>& p) : photo(p) {
        std::copy_n(p.warp, 12, warp), photo.warp = warp;
        std::copy_n(p.intrinsics, 9, intrinsics), photo.intrinsics = intrinsics;
    }
};

// Room for the places of a strip, sorted by the source that they show.
struct Places {
    std::vector<int32_t> end;  // of each source's places
    int32_t sorted[most_sources * strip_pixels];

    explicit Places(std::size_t sources) : end(sources + 1) {}

    void sort(const Ranks& sources, int keep) {
        std::fill(end.begin(), end.end(), 0);
        const int32_t* source = sources[0];
        const int count = keep * strip_pixels;
        for (int i = 0; i < count; ++i) ++end[source[i] + 1];
        int32_t start = 0;
        // Those without a source come first, and end where the first source's begin.
        for (int32_t& e : end) {
            const int32_t n = e;
            e = start, start += n;
        }
        for (int i = 0; i < count; ++i) sorted[end[source[i] + 1]++] = i;
    }
};

template <class T, class Texel>
NMBG_INLINE void blend_any_strip(const Blending<T, Texel>& b, int64_t first, Places& places,
                                 const BlendResult<T>& out) {
    const int keep = b.rule.keep;
    const int64_t pixels = int64_t{b.height} * b.width;
    const BlendRule<T> rule = b.rule;
    const T focal = b.focal;
    const Strip<T> strip(b, first);
    StripMixture<T> mixture;
    Ranks sources;
    for (int k = 0; k <= keep; ++k)
        for (int i = 0; i < strip_pixels; ++i) mixture.score[k][i] = 0, sources[k][i] = -1;
    for (int k = 0; k < keep; ++k)
        for (int c = 0; c < 3; ++c)
            for (int i = 0; i < strip_pixels; ++i) mixture.shown[k][c][i] = 0;

    const auto count = static_cast<int32_t>(b.photos.size());
    for (int32_t s = 0; s < count; ++s) {
        const Source<T, Texel> source(b.photos[s]);
        for (int i0 = 0; i0 < strip_pixels; i0 += lanes)
            rank(source.photo, s, rule, focal, strip, i0, mixture, sources);
    }

    places.sort(sources, keep);
    for (int32_t s = 0; s < count; ++s) {
        const Source<T, Texel> source(b.photos[s]);
        const int32_t end = places.end[s + 1];
        for (int32_t start = places.end[s]; start < end; start += lanes) {
            int32_t some[lanes];  // the last ones are filled up with the very last
            for (int i = 0; i < lanes; ++i) some[i] = places.sorted[start + i < end ? start + i : end - 1];
            show(source.photo, rule, focal, strip, some, mixture);
        }
    }

    mixture.mix(keep);
    const auto write = [&](const T* values, T* to)
                           NMBG_INLINE_LAMBDA { std::copy_n(values, strip.pixels, to + first); };
    write(mixture.score[0], out.weight);
    write(mixture.variance, out.variance);
    for (int c = 0; c < 3; ++c) write(mixture.colour[c], out.colour + c * pixels);
    for (int k = 0; k < keep; ++k) {
        write(mixture.weight[k], out.weights + k * pixels);
        if (out.shown)
            for (int c = 0; c < 3; ++c) write(mixture.shown[k][c], out.shown + (3 * k + c) * pixels);
    }
    for (int i = 0; i < strip.pixels; ++i)
        for (int k = 0; k <= keep; ++k) out.sources[(keep + 1) * (first + i) + k] = sources[k][i];
}

NMBG_WIDEST void blend_strip(const Blending<float, uint8_t>& b, int64_t first, Places& places,
                             const BlendResult<float>& out) {
    blend_any_strip(b, first, places, out);
}
NMBG_WIDEST void blend_strip(const Blending<float, float>& b, int64_t first, Places& places,
                             const BlendResult<float>& out) {
    blend_any_strip(b, first, places, out);
}
template <class Texel>
void blend_strip(const Blending<double, Texel>& b, int64_t first, Places& places,
                 const BlendResult<double>& out) {
    blend_any_strip(b, first, places, out);
}

}  // namespace

template <class T, class Texel>
void blend_photos(const Blending<T, Texel>& b, const BlendResult<T>& out) {
    parallel_blocks(int64_t{b.height} * b.width, b.threads, [&](int64_t begin, int64_t end) {
        Places places(b.photos.size());
        for (int64_t first = begin; first < end; first += strip_pixels) blend_strip(b, first, places, out);
    });
}

template void blend_photos(const Blending<float, uint8_t>&, const BlendResult<float>&);
template void blend_photos(const Blending<float, float>&, const BlendResult<float>&);
template void blend_photos(const Blending<double, uint8_t>&, const BlendResult<double>&);
template void blend_photos(const Blending<double, double>&, const BlendResult<double>&);

}  // namespace nmbg
