#include "core/blend_photos.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/dual.h"
#include "core/parallel.h"

// One binary for all x86-64: the loader picks the widest vectors that the processor has.
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define NMBG_WIDEST __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define NMBG_WIDEST
#endif
// Into every clone: what is not inlined is compiled once, for the narrowest.
#if defined(__GNUC__)
#define NMBG_INLINE inline __attribute__((always_inline))
#else
#define NMBG_INLINE inline
#endif

namespace nmbg {
namespace {

using std::abs;
using std::log2;
using std::sqrt;

// What follows, as far as it is inlined always, is computed for many pixels at a time: it selects instead of
// branching, one comparison a selection, and passes scalars by value.

template <class S>
NMBG_INLINE S lesser(S a, S b) {
    return b < a ? b : a;
}

template <class S>
NMBG_INLINE S within_unit(S x) {
    const S capped = lesser(x, S(1));
    return capped > S(0) ? capped : S(0);  // 0 for what is not a number, too
}

// i, but at least 0 and at most `last`.
NMBG_INLINE int32_t held(int32_t i, int32_t last) {
    const int32_t capped = i < last ? i : last;
    return capped > 0 ? capped : 0;
}

// Angles below this do not tell sources apart; rounds off the cone of the angle at zero.
constexpr double least_angle = 1e-3;
// Share of their own score that sources keep when the next one is as good: all equal, all count the same.
constexpr double least_share = 1e-4;
// Coarser mip levels are read only from this many halvings on: bilinear weights blur enough before.
constexpr double sharpness = 0.5;

// Where a source sees a point, and how well but for visibility.
template <class S>
struct Sight {
    S u, v;   // px, held within a pixel of the photograph
    S z;      // view-space depth
    S finer;  // source pixels per pixel of the new view
    S score;
};

// g: the point in the source's camera. q: the new view's ray there, of any length. z: its depth in the new
// view.
template <class S, class T, class Texel>
NMBG_INLINE Sight<S> look(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, S z, S gx, S gy,
                          S gz, S qx, S qy, S qz) {
    const T* K = photo.intrinsics;
    const T w = static_cast<T>(photo.width), h = static_cast<T>(photo.height);
    const bool front = lesser(gz, z) > S(0);
    const S inverse = S(1) / (front ? gz : S(1));
    const S u = lesser(S(w + 1), (K[0] * gx + K[1] * gy) * inverse + S(K[2]));
    const S v = lesser(S(h + 1), K[4] * gy * inverse + S(K[5]));
    // A value that is not a number ends at the border, with score 0.
    const S held_u = u > S(-1) ? u : S(-1);
    const S held_v = v > S(-1) ? v : S(-1);
    const S inside = lesser(lesser(held_u, S(w) - held_u), lesser(held_v, S(h) - held_v));
    const S border = within_unit(inside * S(1 / rule.border));

    const S along_g = S(1) / sqrt(gx * gx + gy * gy + gz * gz + S(T(1e-30)));
    const S along_q = S(1) / sqrt(qx * qx + qy * qy + qz * qz + S(T(1e-30)));
    const S dx = gx * along_g - qx * along_q, dy = gy * along_g - qy * along_q,
            dz = gz * along_g - qz * along_q;
    const S angle = sqrt(dx * dx + dy * dy + dz * dz + S(T(least_angle * least_angle)));
    const S near = S(1) / (S(1) + angle * S(1 / rule.angle));
    const S finer = S(K[0] / focal) * z * inverse;
    const S score = border * (near * near) * (near * near) * lesser(finer, S(1));
    return {held_u, held_v, gz, finer, front ? score : S(0)};
}

// 1 on the surface that the source sees, 0 in front of it and behind.
template <class S, class T>
NMBG_INLINE S visible(S z, T surface, T tolerance) {
    const T known = surface > 0 ? surface : T(1);
    const S share = within_unit(S(2) - abs(z - S(known)) * S(1 / (tolerance * known)));
    return surface > 0 ? share : S(0);
}

// The four pixels around a place, and its distance from the first.
template <class S>
struct Footprint {
    int32_t x0, x1, y0, y1;
    S fx, fy;

    NMBG_INLINE Footprint(S u, S v, int32_t width, int32_t height) {
        const S left = u - S(0.5), top = v - S(0.5);
        const auto i = static_cast<int32_t>(std::floor(value_of(left)));
        const auto j = static_cast<int32_t>(std::floor(value_of(top)));
        fx = left - S(static_cast<decltype(value_of(left))>(i));
        fy = top - S(static_cast<decltype(value_of(top))>(j));
        x0 = held(i, width - 1), x1 = held(i + 1, width - 1);
        y0 = held(j, height - 1) * width, y1 = held(j + 1, height - 1) * width;
    }

    // Bilinear weight and offset of pixel n in [0, 4).
    NMBG_INLINE S weight(int n) const { return (n & 1 ? fx : S(1) - fx) * (n & 2 ? fy : S(1) - fy); }
    NMBG_INLINE int32_t offset(int n) const { return (n & 2 ? y1 : y0) + (n & 1 ? x1 : x0); }
};

template <class S, class T, class Texel>
NMBG_INLINE S visibility(const Photo<T, Texel>& photo, const BlendRule<T>& rule, Sight<S> sight) {
    const Footprint<S> four(sight.u, sight.v, photo.width, photo.height);
    const auto seen = [&](int n) {
        return four.weight(n) * visible(sight.z, photo.depth[four.offset(n)], rule.tolerance);
    };
    return (seen(0) + seen(1)) + (seen(2) + seen(3));
}

// Calls visit(texel, weight) for the texels whose weighted sum is the colour that the source shows; the
// weights sum to one. At the finest level only texels of the visible surface count: what lies beyond an edge
// does not bleed.
template <class S, class T, class Texel, class Visit>
NMBG_INLINE void visit_texels(const Photo<T, Texel>& photo, const BlendRule<T>& rule, const Sight<S>& sight,
                              const Visit& visit) {
    int32_t width = photo.width, height = photo.height;
    const S level = sight.finer > S(1) ? log2(sight.finer) - S(T(sharpness)) : S(0);
    const bool coarser = width > 1 || height > 1;  // are there levels but the finest?
    const S fine_share = coarser && level > S(0) ? within_unit(S(1) - level) : S(1);
    if (fine_share > S(0)) {
        const Footprint<S> four(sight.u, sight.v, width, height);
        std::array<S, 4> weight;
        S sum(0);
        for (int n = 0; n < 4; ++n) {
            weight[n] = four.weight(n) * visible(sight.z, photo.depth[four.offset(n)], rule.tolerance);
            sum += weight[n];
        }
        if (sum > S(0)) {
            const S scale = fine_share / sum;
            for (int n = 0; n < 4; ++n) visit(four.offset(n), scale * weight[n]);
        }
    }
    int64_t first = 0;
    T scale = 1;
    for (int l = 1; level > S(T(l - 1)) && (width > 1 || height > 1); ++l) {
        first += int64_t{width} * height;
        width = (width + 1) / 2, height = (height + 1) / 2;
        scale /= 2;
        const bool last = width == 1 && height == 1;
        const S distance = abs(level - S(T(l)));
        const S share = last && level > S(T(l)) ? S(1) : within_unit(S(1) - distance);
        if (!(share > S(0))) continue;
        const Footprint<S> four(S(scale) * sight.u, S(scale) * sight.v, width, height);
        for (int n = 0; n < 4; ++n) visit(first + four.offset(n), share * four.weight(n));
    }
}

template <class T>
NMBG_INLINE T unit(uint8_t byte) {
    return T(byte) * T(1.0 / 255);
}
template <class T>
NMBG_INLINE T unit(T value) {
    return value;
}

// A source's score at a point and the colour that it shows there.
template <class S>
struct Shown {
    S score;
    std::array<S, 3> colour{};
};

template <class S, class T, class Texel>
NMBG_INLINE std::array<S, 3> colour_at(const Photo<T, Texel>& photo, const BlendRule<T>& rule,
                                       const Sight<S>& sight) {
    std::array<S, 3> colour{S(0), S(0), S(0)};
    visit_texels(photo, rule, sight, [&](int64_t texel, const S& weight) {
        for (int c = 0; c < 3; ++c) colour[c] += weight * S(unit<T>(photo.texels[3 * texel + c]));
    });
    return colour;
}

template <class S, class T, class Texel>
Shown<S> show(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, const S& z, const S* g,
              const S* q) {
    const Sight<S> sight = look(photo, rule, focal, z, g[0], g[1], g[2], q[0], q[1], q[2]);
    Shown<S> shown{S(0), {S(0), S(0), S(0)}};
    if (!(sight.score > S(0))) return shown;
    shown.score = sight.score * visibility(photo, rule, sight);
    if (shown.score > S(0)) shown.colour = colour_at(photo, rule, sight);
    return shown;
}

// A depth to compute with: 0 stands for everything that is no depth.
template <class T>
NMBG_INLINE T usable(T z) {
    const T finite = z < std::numeric_limits<T>::max() ? z : T(0);
    return finite > 0 ? finite : T(0);
}

// A coordinate of the new view's ray in the camera of a source; `row` is of its warp.
template <class T>
NMBG_INLINE T along(const T* row, T x, T y) {
    return row[0] * x + row[1] * y + row[2];
}

// The new view's ray and the surface point in the camera of a source.
template <class T>
struct Point {
    T q[3], g[3];

    Point(const T* warp, T x, T y, T z) {
        for (int i = 0; i < 3; ++i) {
            q[i] = along(warp + 4 * i, x, y);
            g[i] = z * q[i] + warp[4 * i + 3];
        }
    }
};

// What a pixel's sources give: their weights, and the sums over them.
template <class T>
struct Mixture {
    const Shown<T>* shown;                            // [chosen], the best first
    T weight[most_sources], deviation[most_sources];  // normalised weight; squared distance from the mean
    T colour[3] = {}, total = 0, variance = 0;
    int count;  // sources with a weight

    NMBG_INLINE Mixture(const Shown<T>* all, int chosen, int keep)
        : shown(all), count(std::min(chosen, keep)) {
        const T bar = chosen > keep ? T(1 - least_share) * shown[keep].score : T(0);
        for (int i = 0; i < count; ++i) {
            weight[i] = std::max(T(0), shown[i].score - bar);
            total += weight[i];
        }
        if (!(total > 0)) {
            count = 0;
            return;
        }
        for (int i = 0; i < count; ++i) {
            weight[i] /= total;
            for (int c = 0; c < 3; ++c) colour[c] += weight[i] * shown[i].colour[c];
        }
        for (int i = 0; i < count; ++i) {
            deviation[i] = 0;
            for (int c = 0; c < 3; ++c) {
                const T d = shown[i].colour[c] - colour[c];
                deviation[i] += d * d / 3;
            }
            variance += weight[i] * deviation[i];
        }
    }
};

// A pixel's sources, looked at again: room for what a Mixture points to.
template <class T>
using Chosen = std::array<Shown<T>, most_sources + 1>;

template <class T, class Texel>
Mixture<T> mix(const Blending<T, Texel>& b, const int32_t* sources, T x, T y, T z, Chosen<T>& shown) {
    int chosen = 0;
    const int32_t count = static_cast<int32_t>(b.photos.size());
    for (; chosen <= b.rule.keep; ++chosen) {
        const int32_t s = checked("sources", sources[chosen], -1, count);
        if (s < 0) break;
        const Photo<T, Texel>& photo = b.photos[s];
        const Point<T> point(photo.warp, x, y, z);
        shown[chosen] = show<T>(photo, b.rule, b.focal, z, point.g, point.q);
    }
    return Mixture<T>(shown.data(), chosen, b.rule.keep);
}

// Pixels of a row that are scored together.
constexpr int lanes = 64;

template <class T>
struct Ranking {
    T score[most_sources + 1][lanes];
    int32_t source[most_sources + 1][lanes];
};

// Let a source compete for the pixels (x0 …, y).
template <class T, class Texel>
NMBG_INLINE void rank_source(const Blending<T, Texel>& b, int32_t s, const T* depth, int32_t x0, int32_t y,
                             int n, Ranking<T>& best) {
    // Copies on the stack: the compiler then knows that the loop does not write to them.
    Photo<T, Texel> photo = b.photos[s];
    T warp[12], intrinsics[9];
    std::copy_n(photo.warp, 12, warp), photo.warp = warp;
    std::copy_n(photo.intrinsics, 9, intrinsics), photo.intrinsics = intrinsics;
    const BlendRule<T> rule = b.rule;
    const T focal = b.focal;
    const T row = T(y) + T(0.5);
    T score[lanes];
#pragma omp simd
    for (int i = 0; i < n; ++i) {
        const T z = usable(depth[i]);
        const T x = T(x0 + i) + T(0.5);
        const T qx = along(warp, x, row), qy = along(warp + 4, x, row), qz = along(warp + 8, x, row);
        const Sight<T> sight =
            look<T>(photo, rule, focal, z, z * qx + warp[3], z * qy + warp[7], z * qz + warp[11], qx, qy, qz);
        score[i] = sight.score * visibility(photo, rule, sight);
    }
    int32_t id[lanes];
    for (int i = 0; i < n; ++i) id[i] = s;
    for (int rank = 0; rank <= b.rule.keep; ++rank) {
#pragma omp simd
        for (int i = 0; i < n; ++i) {
            // What was moved down moves down the rest: equal scores stay in the order of their sources.
            const bool better = (score[i] > best.score[rank][i]) | (id[i] != s);
            const T old_score = best.score[rank][i];
            const int32_t old_source = best.source[rank][i];
            best.score[rank][i] = better ? score[i] : old_score;
            best.source[rank][i] = better ? id[i] : old_source;
            score[i] = better ? old_score : score[i];
            id[i] = better ? old_source : id[i];
        }
    }
}

// One row of the new view.
template <class T, class Texel>
NMBG_INLINE void blend_any_row(const Blending<T, Texel>& b, int32_t y, const BlendResult<T>& out) {
    const int keep = b.rule.keep;
    const int64_t pixels = int64_t{b.height} * b.width;
    Ranking<T> best;
    for (int32_t x0 = 0; x0 < b.width; x0 += lanes) {
        const int n = std::min<int32_t>(lanes, b.width - x0);
        const int64_t first = int64_t{y} * b.width + x0;
        for (int rank = 0; rank <= keep; ++rank)
            for (int i = 0; i < lanes; ++i) best.score[rank][i] = 0, best.source[rank][i] = -1;
        for (std::size_t s = 0; s < b.photos.size(); ++s)
            rank_source(b, static_cast<int32_t>(s), b.depth + first, x0, y, n, best);
        for (int i = 0; i < n; ++i) {
            const int64_t pixel = first + i;
            int32_t* chosen = out.sources + (keep + 1) * pixel;
            // Scores are known from the ranking; what is left are the colours.
            Shown<T> shown[most_sources + 1];
            int count = 0;
            for (; count <= keep; ++count) {
                chosen[count] = best.source[count][i];
                if (chosen[count] < 0) break;
                shown[count].score = best.score[count][i];
                if (count == keep) continue;
                const Photo<T, Texel>& photo = b.photos[chosen[count]];
                const T x = T(x0 + i) + T(0.5), row = T(y) + T(0.5), z = b.depth[pixel];
                const T *W = photo.warp, qx = along(W, x, row), qy = along(W + 4, x, row),
                        qz = along(W + 8, x, row);
                const Sight<T> sight = look<T>(photo, b.rule, b.focal, z, z * qx + W[3], z * qy + W[7],
                                               z * qz + W[11], qx, qy, qz);
                shown[count].colour = colour_at(photo, b.rule, sight);
            }
            std::fill(chosen + count, chosen + keep + 1, -1);
            const Mixture<T> mixture(shown, count, keep);
            for (int c = 0; c < 3; ++c) out.colour[c * pixels + pixel] = mixture.colour[c];
            out.weight[pixel] = count > 0 ? shown[0].score : T(0);
            out.variance[pixel] = mixture.variance;
            for (int k = 0; k < keep; ++k) {
                out.weights[k * pixels + pixel] = k < mixture.count ? mixture.weight[k] : T(0);
                if (out.shown)
                    for (int c = 0; c < 3; ++c)
                        out.shown[(3 * k + c) * pixels + pixel] = k < count ? shown[k].colour[c] : T(0);
            }
        }
    }
}

NMBG_WIDEST void blend_row(const Blending<float, uint8_t>& b, int32_t y, const BlendResult<float>& out) {
    blend_any_row(b, y, out);
}
NMBG_WIDEST void blend_row(const Blending<float, float>& b, int32_t y, const BlendResult<float>& out) {
    blend_any_row(b, y, out);
}
template <class Texel>
void blend_row(const Blending<double, Texel>& b, int32_t y, const BlendResult<double>& out) {
    blend_any_row(b, y, out);
}

}  // namespace

template <class T, class Texel>
void blend_photos(const Blending<T, Texel>& b, const BlendResult<T>& out) {
    parallel_for(b.height, b.threads, [&](int64_t y) { blend_row(b, static_cast<int32_t>(y), out); });
}

namespace {

// Gradients of a pixel's outputs with respect to its sources' scores and colours.
template <class T>
struct MixtureGradient {
    std::array<T, most_sources + 1> score{};
    std::array<std::array<T, 3>, most_sources> colour{};

    MixtureGradient(const Mixture<T>& m, const BlendGradient<T>& grad, int64_t pixel, int64_t pixels,
                    int keep) {
        score[0] = grad.weight[pixel];
        const T to_variance = grad.variance[pixel];
        std::array<T, most_sources> to_weight{};
        T mean = 0;
        for (int i = 0; i < m.count; ++i) {
            to_weight[i] = to_variance * m.deviation[i];
            for (int c = 0; c < 3; ++c) {
                const T to_colour = grad.colour[c * pixels + pixel];
                to_weight[i] += to_colour * m.shown[i].colour[c];
                colour[i][c] = m.weight[i] *
                               (to_colour + to_variance * T(2.0 / 3) * (m.shown[i].colour[c] - m.colour[c]));
            }
            mean += m.weight[i] * to_weight[i];
        }
        for (int i = 0; i < m.count; ++i) {
            if (!(m.weight[i] > 0)) continue;
            const T to_score = (to_weight[i] - mean) / m.total;
            score[i] += to_score;
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
    constexpr int64_t band = 16;
    const int64_t bands = (b.height + band - 1) / band;
    std::vector<T> partial(bands * count * 12, T(0));
    parallel_for(bands, b.threads, [&](int64_t which) {
        T* warps = partial.data() + which * count * 12;
        for (int64_t y = which * band; y < std::min<int64_t>(b.height, (which + 1) * band); ++y) {
            for (int32_t x = 0; x < b.width; ++x) {
                const int64_t pixel = y * b.width + x;
                const int32_t* chosen = sources + (keep + 1) * pixel;
                const T p[3] = {T(x) + T(0.5), T(y) + T(0.5), T(1)}, z = usable(b.depth[pixel]);
                Chosen<T> room;
                const Mixture<T> mixture = mix(b, chosen, p[0], p[1], z, room);
                const MixtureGradient<T> down(mixture, grad, pixel, pixels, keep);
                T to_depth = 0;
                for (int k = 0; k <= keep && chosen[k] >= 0; ++k) {
                    const Photo<T, Texel>& photo = b.photos[chosen[k]];
                    const Point<T> point(photo.warp, p[0], p[1], z);
                    S g[3], q[3];
                    for (int i = 0; i < 3; ++i) {
                        g[i] = S::variable(point.g[i], i);
                        q[i] = S::variable(point.q[i], 3 + i);
                    }
                    const Shown<S> shown = show<S>(photo, b.rule, b.focal, S::variable(z, 6), g, q);
                    std::array<T, 7> slope;
                    for (int i = 0; i < 7; ++i) {
                        slope[i] = down.score[k] * shown.score.slope[i];
                        if (k < keep)
                            for (int c = 0; c < 3; ++c)
                                slope[i] += down.colour[k][c] * shown.colour[c].slope[i];
                    }
                    T* warp = warps + 12 * int64_t{chosen[k]};
                    to_depth += slope[6];
                    for (int i = 0; i < 3; ++i) {
                        to_depth += slope[i] * point.q[i];
                        for (int j = 0; j < 3; ++j) warp[4 * i + j] += (z * slope[i] + slope[3 + i]) * p[j];
                        warp[4 * i + 3] += slope[i];
                    }
                }
                grad_depth[pixel] = to_depth;
            }
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
        for (int64_t pixel = 0; pixel < pixels; ++pixel) {
            const int32_t* chosen = sources + (keep + 1) * pixel;
            const auto k = std::find(chosen, chosen + keep, static_cast<int32_t>(s)) - chosen;
            if (k == keep) continue;
            const T x = T(pixel % b.width) + T(0.5), y = T(pixel / b.width) + T(0.5),
                    z = usable(b.depth[pixel]);
            Chosen<T> room;
            const Mixture<T> mixture = mix(b, chosen, x, y, z, room);
            if (!(mixture.shown[k].score > 0)) continue;
            const MixtureGradient<T> down(mixture, grad, pixel, pixels, keep);
            const Point<T> point(photo.warp, x, y, z);
            const Sight<T> sight = look<T>(photo, b.rule, b.focal, z, point.g[0], point.g[1], point.g[2],
                                           point.q[0], point.q[1], point.q[2]);
            visit_texels(photo, b.rule, sight, [&](int64_t texel, T weight) {
                for (int c = 0; c < 3; ++c) grad_texels[s][3 * texel + c] += weight * down.colour[k][c];
            });
        }
    });
}

template void blend_photos(const Blending<float, uint8_t>&, const BlendResult<float>&);
template void blend_photos(const Blending<float, float>&, const BlendResult<float>&);
template void blend_photos(const Blending<double, uint8_t>&, const BlendResult<double>&);
template void blend_photos(const Blending<double, double>&, const BlendResult<double>&);
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
