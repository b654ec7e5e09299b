// Blending a strip of pixels, see blend_photos.h. Read once per instruction set (each_isa.h).

#include "core/photo_sight.inl"

namespace nmbg::NMBG_ISA {

// Pixels that are looked at together.
template <class T>
using numbers = vector_of<T, abreast<T>>;
template <class T>
using indices = vector_of<int32_t, abreast<T>>;

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
        int32_t row = static_cast<int32_t>(first / b.width), column = static_cast<int32_t>(first % b.width);
        for (int i = 0; i < strip_pixels; column = 0, ++row) {
            const int end = std::min(strip_pixels, i + b.width - column);
            for (; i < end; ++i, ++column) x[i] = T(column) + T(0.5), y[i] = T(row) + T(0.5);
        }
        for (int i = 0; i < pixels; ++i) z[i] = usable(b.depth[first + i]);
        for (int i = pixels; i < strip_pixels; ++i) z[i] = 0;
    }

    NMBG_INLINE bool empty() const {
        return std::all_of(z, z + strip_pixels, [](T depth) { return depth == 0; });
    }
};

template <class T>
using StripMixture = Mixture<T, strip_pixels>;

// Let a source compete for the pixels from i0 on.
template <class T, class Texel>
NMBG_INLINE void rank(const Photo<T, Texel>& photo, int32_t s, const BlendRule<T>& rule, T focal,
                      const Strip<T>& strip, int i0, StripMixture<T>& best, Ranks& ranks) {
    using V = numbers<T>;
    using I = indices<T>;
    const V depth = load<V>(strip.z + i0), least = load<V>(best.score[rule.keep] + i0);
    const Sight<V> sight = look(photo, rule, focal, depth,
                                warped(photo.warp, load<V>(strip.x + i0), load<V>(strip.y + i0), depth));
    if (!any_of(sight.score > least)) return;
    const Footprint<V> four(sight.u, sight.v, photo.width, photo.height);
    const V visible = sum(seen(photo, rule, four, sight.z));
    V score = sight.score * visible;
    auto better = score > least;
    if (!any_of(better)) return;
    const auto partly = narrow(visible < sum(four.weights()));
    I id = splat<I>(2 * s) - partly;  // a mask's elements are 0 and -1
    better = decltype(better){};
    for (int k = 0; k <= rule.keep; ++k) {
        T* scores = best.score[k] + i0;
        int32_t* ids = ranks[k] + i0;
        const V old_score = load<V>(scores);
        const I old_id = load<I>(ids);
        // What was moved down moves down the rest: equal scores stay in the order of their sources.
        better |= score > old_score;
        store(select<decltype(better), V>(better, score, old_score), scores);
        store(select<I, I>(narrow(better), id, old_id), ids);
        score = select<decltype(better), V>(better, old_score, score);
        id = select<I, I>(narrow(better), old_id, id);
    }
}

// The weighted sum of four texels of a level.
template <class T, class V>
NMBG_INLINE Rgb<V> filtered(const uint8_t* texels, const Footprint<V>& four, const Four<V>& weight) {
    const Four<indices<T>> word = four_of<indices<T>>(texels, four);
    return (weight.a * colour_of<V>(word.a) + weight.b * colour_of<V>(word.b)) +
           (weight.c * colour_of<V>(word.c) + weight.d * colour_of<V>(word.d));
}
template <class T, class V>
NMBG_INLINE Rgb<V> filtered(const T* texels, const Footprint<V>& four, const Four<V>& weight) {
    const auto of = [&](int n) NMBG_INLINE_LAMBDA {
        const indices<T> at = four.offset(n);
        Rgb<V> colour;
        for (int i = 0; i < width_of<V>; ++i) {
            const Rgb<T> one = texel<T>(texels, at[i]);
            colour.red[i] = one.red, colour.green[i] = one.green, colour.blue[i] = one.blue;
        }
        return colour;
    };
    return (weight.a * of(0) + weight.b * of(1)) + (weight.c * of(2) + weight.d * of(3));
}

// The colours that a source shows in some of a strip's pixels: place k · strip_pixels + i is of rank k in
// pixel i. Where all pixels around show the surface, their bilinear weights are those of the finest level.
template <bool partly, class T, class Texel>
NMBG_INLINE void show(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, const Strip<T>& strip,
                      const indices<T>& places, StripMixture<T>& mixture) {
    using V = numbers<T>;
    const indices<T> pixel = places & (strip_pixels - 1);
    const V x = gather<V>(strip.x, pixel), y = gather<V>(strip.y, pixel), depth = gather<V>(strip.z, pixel);
    const Sight<V> sight = look(photo, rule, focal, depth, warped(photo.warp, x, y, depth));
    V level{};
    T coarsest = 0;
    if (any_of(sight.finer > T(1)))
        for (int i = 0; i < width_of<V>; ++i) {
            level[i] = level_for(T(sight.finer[i]));
            coarsest = std::max(coarsest, T(level[i]));
        }
    MipLevel mip{photo.height, photo.width};
    const Footprint<V> four(sight.u, sight.v, mip.width, mip.height);
    Rgb<V> colour =
        share_of(mip, level) *
        filtered<T>(photo.texels, four, partly ? finest_weights(photo, rule, four, sight.z) : four.weights());
    T scale = 1;
    while (coarsest > T(mip.index) && !mip.last()) {
        mip = mip.next();
        scale /= 2;
        const Footprint<V> coarse(scale * sight.u, scale * sight.v, mip.width, mip.height);
        colour = colour +
                 share_of(mip, level) * filtered<T>(photo.texels + 4 * mip.first, coarse, coarse.weights());
    }
    colour = splat<V>(1 / full<T, Texel>) * colour;
    // Place (k, i) of [keep, pixels] in [keep, channels, pixels].
    const indices<T> to = 3 * places - 2 * pixel;
    T* red = mixture.shown[0][0];
    scatter(colour.red, red, to), scatter(colour.green, red + strip_pixels, to);
    scatter(colour.blue, red + 2 * strip_pixels, to);
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

template <bool partly, class T, class Texel>
NMBG_INLINE void show_places(const Photo<T, Texel>& photo, int32_t id, const BlendRule<T>& rule, T focal,
                             const Strip<T>& strip, const SortedPlaces& places, StripMixture<T>& mixture) {
    const int32_t end = places.end[id + 1];
    using I = indices<T>;
    int32_t start = places.end[id];
    for (; start + abreast<T> <= end; start += abreast<T>)
        show<partly>(photo, rule, focal, strip, load<I>(places.sorted + start), mixture);
    if (start == end) return;
    I some = splat<I>(places.sorted[end - 1]);
    for (int i = 0; start + i < end; ++i) some[i] = places.sorted[start + i];
    show<partly>(photo, rule, focal, strip, some, mixture);
}

template <class T, class Texel>
void blend_strip(const Blending<T, Texel>& b, int64_t first, SortedPlaces& places,
                 const BlendResult<T>& out) {
    const int keep = b.rule.keep;
    const int64_t pixels = int64_t{b.height} * b.width;
    const BlendRule<T> rule = b.rule;
    const T focal = b.focal;
    const Strip<T> strip(b, first);
    StripMixture<T> mixture;
    Ranks ranks;
    for (int k = 0; k <= keep; ++k)
        for (int i = 0; i < strip_pixels; ++i) mixture.score[k][i] = 0, ranks[k][i] = -1;
    for (int k = 0; k < keep; ++k)
        for (int c = 0; c < 3; ++c)
            for (int i = 0; i < strip_pixels; ++i) mixture.shown[k][c][i] = 0;

    const auto count = strip.empty() ? 0 : static_cast<int32_t>(b.photos.size());
    for (int32_t s = 0; s < count; ++s) {
        const Source<T, Texel> source(b.photos[s]);
        for (int i0 = 0; i0 < strip_pixels; i0 += abreast<T>)
            rank(source.photo, s, rule, focal, strip, i0, mixture, ranks);
    }

    places.sort(ranks, keep);
    for (int32_t s = 0; s < count; ++s) {
        const Source<T, Texel> source(b.photos[s]);
        show_places<false>(source.photo, 2 * s, rule, focal, strip, places, mixture);
        show_places<true>(source.photo, 2 * s + 1, rule, focal, strip, places, mixture);
    }

    mixture.mix(keep);
    const auto write = [&](const T* values, T* to)
                           NMBG_INLINE_LAMBDA { std::copy_n(values, strip.pixels, to + first); };
    write(mixture.score[0], out.weight);
    write(mixture.variance, out.variance);
    for (int c = 0; c < 3; ++c) write(mixture.colour[c], out.colour + c * pixels);
    for (int k = 0; k < keep; ++k) {
        if (out.weights) write(mixture.weight[k], out.weights + k * pixels);
        if (out.shown)
            for (int c = 0; c < 3; ++c) write(mixture.shown[k][c], out.shown + (3 * k + c) * pixels);
    }
    if (out.sources)
        for (int i = 0; i < strip.pixels; ++i)
            for (int k = 0; k <= keep; ++k) out.sources[(keep + 1) * (first + i) + k] = ranks[k][i] >> 1;
}

}  // namespace nmbg::NMBG_ISA
