#include <algorithm>
#include <array>
#include <bit>
#include <vector>

#include "core/blend_photos.h"
#include "core/check.h"
#include "core/dual.h"
#include "core/mixture.h"
#include "core/parallel.h"
#include "core/portable.h"

#define NMBG_ISA portable
#include "core/photo_sight.inl"
#undef NMBG_ISA

namespace nmbg {
namespace {

using namespace portable;

// Calls visit(texel, weight) for the texels whose weighted sum is the colour that the photograph shows; the
// weights sum to one.
template <class S, class T, class Texel, class Visit>
void visit_texels(const Photo<T, Texel>& photo, const BlendRule<T>& rule, const Sight<S>& sight,
                  const Visit& visit) {
    const S level = level_for(sight.finer);
    T scale = 1;
    for (MipLevel mip{photo.height, photo.width};; mip = mip.next(), scale /= 2) {
        const S share = share_of(mip, level);
        if (share > S(0)) {
            const Footprint<S> four(S(scale) * sight.u, S(scale) * sight.v, mip.width, mip.height);
            const Four<S> weights =
                mip.index == 0 ? finest_weights(photo, rule, four, sight.z) : four.weights();
            for (int n = 0; n < 4; ++n) visit(mip.first + four.offset(n), share * weights[n]);
        }
        if (mip.last() || !(level > S(T(mip.index)))) return;
    }
}

// A source's score at a point and the colour that it shows there.
template <class S>
struct Shown {
    S score;
    std::array<S, 3> colour;
};

template <class S, class T, class Texel>
Shown<S> show(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, const S& z,
              const Point<S>& point) {
    const Sight<S> sight = look(photo, rule, focal, z, point);
    Shown<S> shown{S(0), {S(0), S(0), S(0)}};
    if (!(sight.score > S(0))) return shown;
    const Footprint<S> four(sight.u, sight.v, photo.width, photo.height);
    shown.score = sight.score * sum(seen(photo, rule, four, sight.z));
    if (!(shown.score > S(0))) return shown;
    visit_texels(photo, rule, sight, [&](int64_t i, const S& weight) {
        const Rgb<T> colour = texel<T>(photo.texels, i);
        shown.colour[0] += weight * S(colour.red);
        shown.colour[1] += weight * S(colour.green);
        shown.colour[2] += weight * S(colour.blue);
    });
    for (S& c : shown.colour) c = c * S(1 / full<T, Texel>);
    return shown;
}

// A pixel of the new view, and the sources that were chosen for it, the best first.
template <class T, class Texel>
struct Pixel {
    T x, y, z;
    const int32_t* sources;
    int chosen = 0;
    Mixture<T, 1> mixture{};

    Pixel(const Blending<T, Texel>& b, const int32_t* all_sources, int64_t pixel)
        : x(T(pixel % b.width) + T(0.5)),
          y(T(pixel / b.width) + T(0.5)),
          z(usable(b.depth[pixel])),
          sources(all_sources + (b.rule.keep + 1) * pixel) {
        const auto count = static_cast<int64_t>(b.photos.size());
        for (; chosen <= b.rule.keep; ++chosen) {
            const int32_t s = checked("sources", sources[chosen], -1, count);
            if (s < 0) break;
            const Shown<T> shown = show<T>(b.photos[s], b.rule, b.focal, z, point(b.photos[s]));
            mixture.score[chosen][0] = shown.score;
            if (chosen < b.rule.keep)
                for (int c = 0; c < 3; ++c) mixture.shown[chosen][c][0] = shown.colour[c];
        }
        mixture.mix(b.rule.keep);
    }

    Point<T> point(const Photo<T, Texel>& photo) const { return warped(photo.warp, x, y, z); }
};

// Gradients of a pixel's outputs with respect to its sources' scores and colours.
template <class T>
struct MixtureGradient {
    std::array<T, most_sources + 1> score{};
    std::array<std::array<T, 3>, most_sources> colour{};

    MixtureGradient(const Mixture<T, 1>& m, const BlendGradient<T>& grad, int64_t pixel, int64_t pixels,
                    int keep) {
        score[0] = grad.weight[pixel];
        const T to_variance = grad.variance[pixel];
        std::array<T, most_sources> to_weight{};
        T mean = 0;
        for (int k = 0; k < keep; ++k) {
            to_weight[k] = to_variance * m.deviation[k][0];
            for (int c = 0; c < 3; ++c) {
                const T to_colour = grad.colour[c * pixels + pixel], shown = m.shown[k][c][0];
                to_weight[k] += to_colour * shown;
                colour[k][c] =
                    m.weight[k][0] * (to_colour + to_variance * T(2.0 / 3) * (shown - m.colour[c][0]));
            }
            mean += m.weight[k][0] * to_weight[k];
        }
        for (int k = 0; k < keep; ++k) {
            if (!(m.weight[k][0] > 0)) continue;
            const T to_score = (to_weight[k] - mean) / m.total[0];
            score[k] += to_score;
            score[keep] -= T(1 - least_share) * to_score;
        }
    }
};

}  // namespace

template <class T, class Texel>
void blend_photos_backward(const Blending<T, Texel>& b, const int32_t* sources, const BlendGradient<T>& grad,
                           T* grad_depth, T* grad_warps) {
    using S = Dual<T, 7>;  // of g, q and z
    const int keep = b.rule.keep;
    const int64_t pixels = int64_t{b.height} * b.width, count = static_cast<int64_t>(b.photos.size());
    // Bands of rows have sums of their own, added up in order: the same bits for any number of threads.
    const int64_t band = 16 * int64_t{b.width}, bands = (pixels + band - 1) / band;
    std::vector<T> partial(bands * count * 12, T(0));
    parallel_for(bands, b.threads, [&](int64_t which) {
        T* warps = partial.data() + which * count * 12;
        for (int64_t i = which * band; i < std::min(pixels, (which + 1) * band); ++i) {
            const Pixel<T, Texel> pixel(b, sources, i);
            const MixtureGradient<T> down(pixel.mixture, grad, i, pixels, keep);
            const T p[3] = {pixel.x, pixel.y, T(1)}, z = pixel.z;
            T to_depth = 0;
            for (int k = 0; k < pixel.chosen; ++k) {
                const Photo<T, Texel>& photo = b.photos[pixel.sources[k]];
                const Point<T> point = pixel.point(photo);
                Point<S> moving;
                for (int j = 0; j < 3; ++j) {
                    moving.g[j] = S::variable(point.g[j], j);
                    moving.q[j] = S::variable(point.q[j], 3 + j);
                }
                const Shown<S> shown = show<S>(photo, b.rule, b.focal, S::variable(z, 6), moving);
                std::array<T, 7> slope;
                for (int j = 0; j < 7; ++j) {
                    slope[j] = down.score[k] * shown.score.slope[j];
                    if (k < keep)
                        for (int c = 0; c < 3; ++c) slope[j] += down.colour[k][c] * shown.colour[c].slope[j];
                }
                T* warp = warps + 12 * int64_t{pixel.sources[k]};
                to_depth += slope[6];
                for (int j = 0; j < 3; ++j) {
                    to_depth += slope[j] * point.q[j];
                    for (int c = 0; c < 3; ++c) warp[4 * j + c] += (z * slope[j] + slope[3 + j]) * p[c];
                    warp[4 * j + 3] += slope[j];
                }
            }
            grad_depth[i] = to_depth;
        }
    });
    std::fill(grad_warps, grad_warps + count * 12, T(0));
    for (int64_t which = 0; which < bands; ++which)
        for (int64_t i = 0; i < count * 12; ++i) grad_warps[i] += partial[which * count * 12 + i];
}

template <class T>
void blend_photos_backward_texels(const Blending<T, T>& b, const int32_t* sources,
                                  const BlendGradient<T>& grad, const std::vector<T*>& grad_texels) {
    const int keep = b.rule.keep;
    const int64_t pixels = int64_t{b.height} * b.width;
    // A photograph belongs to one thread, which visits the pixels in order.
    parallel_for(static_cast<int64_t>(b.photos.size()), b.threads, [&](int64_t s) {
        const Photo<T, T>& photo = b.photos[s];
        for (int64_t i = 0; i < pixels; ++i) {
            const int32_t* chosen = sources + (keep + 1) * i;
            const auto k = std::find(chosen, chosen + keep, static_cast<int32_t>(s)) - chosen;
            if (k == keep) continue;
            const Pixel<T, T> pixel(b, sources, i);
            if (!(pixel.mixture.score[k][0] > 0)) continue;
            const MixtureGradient<T> down(pixel.mixture, grad, i, pixels, keep);
            const Sight<T> sight = look<T>(photo, b.rule, b.focal, pixel.z, pixel.point(photo));
            visit_texels(photo, b.rule, sight, [&](int64_t texel, T weight) {
                for (int c = 0; c < 3; ++c) grad_texels[s][4 * texel + c] += weight * down.colour[k][c];
            });
        }
    });
}

template void blend_photos_backward(const Blending<float, uint8_t>&, const int32_t*,
                                    const BlendGradient<float>&, float*, float*);
template void blend_photos_backward(const Blending<float, float>&, const int32_t*,
                                    const BlendGradient<float>&, float*, float*);
template void blend_photos_backward(const Blending<double, uint8_t>&, const int32_t*,
                                    const BlendGradient<double>&, double*, double*);
template void blend_photos_backward(const Blending<double, double>&, const int32_t*,
                                    const BlendGradient<double>&, double*, double*);
template void blend_photos_backward_texels(const Blending<float, float>&, const int32_t*,
                                           const BlendGradient<float>&, const std::vector<float*>&);
template void blend_photos_backward_texels(const Blending<double, double>&, const int32_t*,
                                           const BlendGradient<double>&, const std::vector<double*>&);

}  // namespace nmbg
