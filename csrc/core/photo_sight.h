// How one photograph sees a point. S is T, or a Dual of it, which gives the derivatives too.
//
// All of it is computed for many points at a time, where T is a number and the call is in a loop: it selects
// instead of branching, one comparison a selection, and passes scalars by value.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "core/blend_photos.h"
#include "core/dual.h"
#include "core/vectors.h"

namespace nmbg {

template <class S>
NMBG_INLINE S lesser(S a, S b) {
    return b < a ? b : a;
}

template <class S>
NMBG_INLINE S within_unit(S x) {
    const S capped = lesser(x, S(1));
    return capped > S(0) ? capped : S(0);  // 0 for what is not a number, too
}

// The integer at x or next below.
template <class T>
NMBG_INLINE int32_t floored(T x) {
    const auto towards_zero = static_cast<int32_t>(x);
    return towards_zero - (static_cast<T>(towards_zero) > x ? 1 : 0);
}

// i, but at least 0 and at most `last`.
NMBG_INLINE int32_t held(int32_t i, int32_t last) {
    const int32_t capped = i < last ? i : last;
    return capped > 0 ? capped : 0;
}

// A depth to compute with: 0 stands for everything that is no depth.
template <class T>
NMBG_INLINE T usable(T z) {
    const T finite = z < std::numeric_limits<T>::max() ? z : T(0);
    return finite > 0 ? finite : T(0);
}

// Angles below this do not tell sources apart; rounds off the cone of the angle at zero.
constexpr double least_angle = 1e-3;
// Coarser mip levels are read only from this many halvings on: bilinear weights blur enough before.
constexpr double sharpness = 0.5;

// A surface point in the camera of a photograph, and the new view's ray there, of any length.
template <class S>
struct Point {
    S g[3], q[3];
};

// The point that the new view sees at pixel (x, y) and depth z; warp [3, 4].
template <class T>
NMBG_INLINE Point<T> warped(const T* warp, T x, T y, T z) {
    Point<T> point;
    for (int i = 0; i < 3; ++i) {
        point.q[i] = warp[4 * i] * x + warp[4 * i + 1] * y + warp[4 * i + 2];
        point.g[i] = z * point.q[i] + warp[4 * i + 3];
    }
    return point;
}

// Where a photograph sees a point, and how well but for visibility.
template <class S>
struct Sight {
    S u, v;   // px, held within a pixel of the photograph
    S z;      // view-space depth
    S finer;  // source pixels per pixel of the new view
    S score;
};

// z: depth of the point in the new view.
template <class S, class T, class Texel>
NMBG_INLINE Sight<S> look(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, S z,
                          const Point<S>& point) {
    using std::sqrt;
    const S gx = point.g[0], gy = point.g[1], gz = point.g[2];
    const S qx = point.q[0], qy = point.q[1], qz = point.q[2];
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

// A value for each of four pixels.
template <class S>
struct Four {
    S a, b, c, d;
    NMBG_INLINE S operator[](int n) const { return n & 2 ? (n & 1 ? d : c) : (n & 1 ? b : a); }
};

template <class S>
NMBG_INLINE S sum(Four<S> x) {
    return (x.a + x.b) + (x.c + x.d);
}

// The four pixels around a place, and its distance from the first.
template <class S>
struct Footprint {
    int32_t x0, x1, y0, y1;
    S fx, fy;

    NMBG_INLINE Footprint(S u, S v, int32_t width, int32_t height) {
        const S left = u - S(0.5), top = v - S(0.5);
        const int32_t i = floored(value_of(left)), j = floored(value_of(top));
        fx = left - S(static_cast<decltype(value_of(left))>(i));
        fy = top - S(static_cast<decltype(value_of(top))>(j));
        x0 = held(i, width - 1), x1 = held(i + 1, width - 1);
        y0 = held(j, height - 1) * width, y1 = held(j + 1, height - 1) * width;
    }

    // Bilinear weight and offset of pixel n in [0, 4).
    NMBG_INLINE S weight(int n) const { return (n & 1 ? fx : S(1) - fx) * (n & 2 ? fy : S(1) - fy); }
    NMBG_INLINE Four<S> weights() const { return {weight(0), weight(1), weight(2), weight(3)}; }
    NMBG_INLINE int32_t offset(int n) const { return (n & 2 ? y1 : y0) + (n & 1 ? x1 : x0); }
};

// 1 on the surface that the photograph sees, 0 in front of it and behind.
template <class S, class T>
NMBG_INLINE S visible(S z, T surface, T tolerance) {
    using std::abs;
    const T known = surface > 0 ? surface : T(1);
    const S share = within_unit(S(2) - abs(z - S(known)) * S(1 / (tolerance * known)));
    return surface > 0 ? share : S(0);
}

// Bilinear weights, as far as the pixels show the surface at depth z: their sum says how visible it is.
template <class S, class T, class Texel>
NMBG_INLINE Four<S> seen(const Photo<T, Texel>& photo, const BlendRule<T>& rule, const Footprint<S>& four,
                         S z) {
    const Four<S> share = four.weights();
    return {share.a * visible(z, photo.depth[four.offset(0)], rule.tolerance),
            share.b * visible(z, photo.depth[four.offset(1)], rule.tolerance),
            share.c * visible(z, photo.depth[four.offset(2)], rule.tolerance),
            share.d * visible(z, photo.depth[four.offset(3)], rule.tolerance)};
}

// A level of a mip chain.
struct MipLevel {
    int32_t height, width;
    int32_t index = 0;
    int64_t first = 0;  // texel of the chain

    bool last() const { return height == 1 && width == 1; }
    MipLevel next() const {
        return {(height + 1) / 2, (width + 1) / 2, index + 1, first + int64_t{height} * width};
    }
};

// The level to read where the photograph is this much finer than the new view; a fraction lies between two.
template <class S>
S level_for(S finer) {
    using std::log2;
    const S level = finer > S(1) ? log2(finer) - S(decltype(value_of(finer))(sharpness)) : S(0);
    return level > S(0) ? level : S(0);
}

// How much a level of a mip chain counts in a colour.
template <class S, class T>
NMBG_INLINE S share_of(T index, bool last, S level) {
    using std::abs;
    const S distance = abs(level - S(index));
    const S share = within_unit(S(1) - distance);
    return (last & (level > S(index))) ? S(1) : share;
}

// Weights of the four texels of the finest level in its colour. Only those of the visible surface count: what
// lies beyond an edge does not bleed.
template <class S, class T, class Texel>
NMBG_INLINE Four<S> finest_weights(const Photo<T, Texel>& photo, const BlendRule<T>& rule,
                                   const Footprint<S>& four, S z) {
    const Four<S> weight = seen(photo, rule, four, z);
    const S total = sum(weight);
    const S scale = S(1) / (total > S(0) ? total : S(1));
    return {scale * weight.a, scale * weight.b, scale * weight.c, scale * weight.d};
}

// A texel's colour, of which `one` stands for 1.
template <class T>
struct Rgb {
    T red, green, blue;
    NMBG_INLINE friend Rgb operator*(T s, Rgb x) { return {s * x.red, s * x.green, s * x.blue}; }
    NMBG_INLINE friend Rgb operator+(Rgb x, Rgb y) {
        return {x.red + y.red, x.green + y.green, x.blue + y.blue};
    }
};

template <class T, class Texel>
constexpr T one = T(std::is_same_v<Texel, uint8_t> ? 255 : 1);

template <class T>
NMBG_INLINE Rgb<T> texel(const T* texels, int64_t i) {
    return {texels[4 * i], texels[4 * i + 1], texels[4 * i + 2]};
}

// Bytes come as one word.
template <class T>
NMBG_INLINE Rgb<T> texel(const uint8_t* texels, int64_t i) {
    static_assert(std::endian::native == std::endian::little);
    uint32_t word;
    std::memcpy(&word, texels + 4 * i, 4);
    const auto byte = [word](int n)
                          NMBG_INLINE_LAMBDA { return T(static_cast<int32_t>(word >> 8 * n & 255)); };
    return {byte(0), byte(1), byte(2)};
}

}  // namespace nmbg
