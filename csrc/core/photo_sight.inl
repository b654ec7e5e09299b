// How one photograph sees points. S is a number T, a vector V of them, or a Dual of a number, which gives the
// derivatives too. Read once per instruction set, see lanes.inl.

namespace nmbg::NMBG_ISA {

// Vectors and numbers are what they are; dual.h has it for the others.
template <class S>
    requires(!std::is_class_v<S>)
NMBG_INLINE S value_of(const S& x) {
    return x;
}

template <class S>
NMBG_INLINE S within_unit(const S& x) {
    const S capped = least_of(x, splat<S>(1)), zero = splat<S>(0);
    return select(capped > zero, capped, zero);  // 0 for what is not a number, too
}

template <class S>
NMBG_INLINE S magnitude(const S& x) {
    return select(x < splat<S>(0), -x, x);
}

template <class S>
NMBG_INLINE S root(const S& x) {
    using std::sqrt;
    if constexpr (std::is_arithmetic_v<S> || std::is_class_v<S>) {
        return sqrt(x);
    } else {
#if defined(NMBG_AVX512)
        if constexpr (std::is_same_v<S, vector_of<float, 16>>)
            return (S)_mm512_maskz_sqrt_ps(0xffff, (__m512)x);
#elif defined(NMBG_AVX2)
        if constexpr (std::is_same_v<S, f32x8>) return (S)_mm256_sqrt_ps((__m256)x);
#endif
        S roots;
        for (int i = 0; i < width_of<S>; ++i) roots[i] = sqrt(x[i]);
        return roots;
    }
}

// A depth to compute with: 0 stands for everything that is no depth.
template <class S>
NMBG_INLINE S usable(const S& z) {
    const S zero = splat<S>(0);
    const S finite = select(z < splat<S>(std::numeric_limits<element_of<S>>::max()), z, zero);
    return select(finite > zero, finite, zero);
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
template <class S, class T>
NMBG_INLINE Point<S> warped(const T* warp, const S& x, const S& y, const S& z) {
    Point<S> point;
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
NMBG_INLINE Sight<S> look(const Photo<T, Texel>& photo, const BlendRule<T>& rule, T focal, const S& z,
                          const Point<S>& point) {
    const S gx = point.g[0], gy = point.g[1], gz = point.g[2];
    const S qx = point.q[0], qy = point.q[1], qz = point.q[2];
    const S zero = splat<S>(0), one = splat<S>(1);
    const T* K = photo.intrinsics;
    const T w = static_cast<T>(photo.width), h = static_cast<T>(photo.height);
    const auto front = least_of(gz, z) > zero;
    const S inverse = one / select(front, gz, one);
    const S u = least_of(splat<S>(w + 1), (K[0] * gx + K[1] * gy) * inverse + K[2]);
    const S v = least_of(splat<S>(h + 1), K[4] * gy * inverse + K[5]);
    // A value that is not a number ends at the border, with score 0.
    const S held_u = select(u > -one, u, -one), held_v = select(v > -one, v, -one);
    const S inside = least_of(least_of(held_u, w - held_u), least_of(held_v, h - held_v));
    const S border = within_unit<S>(inside * (1 / rule.border));

    // Twice the sine of half the angle: from the sine squared, or, where the rays part, from the cosine.
    const S nx = gy * qz - gz * qy, ny = gz * qx - gx * qz, nz = gx * qy - gy * qx;
    const S dot = gx * qx + gy * qy + gz * qz;
    const S squares = (gx * gx + gy * gy + gz * gz) * (qx * qx + qy * qy + qz * qz) + T(1e-30);
    const S length = root(squares);
    const auto apart = dot < zero;
    const S chord2 = T(2) * select<decltype(apart), S>(apart, length - dot, nx * nx + ny * ny + nz * nz) /
                     select<decltype(apart), S>(apart, length, squares + dot * length);
    const S angle = root<S>(chord2 + T(least_angle * least_angle));
    const S near = one / (one + angle * (1 / rule.angle));
    const S finer = (K[0] / focal) * z * inverse;
    const S score = border * (near * near) * (near * near) * least_of(finer, one);
    return {held_u, held_v, gz, finer, select(front, score, zero)};
}

// A value for each of four pixels.
template <class S>
struct Four {
    S a, b, c, d;
    NMBG_INLINE S operator[](int n) const { return n & 2 ? (n & 1 ? d : c) : (n & 1 ? b : a); }
};

template <class S>
NMBG_INLINE S sum(const Four<S>& x) {
    return (x.a + x.b) + (x.c + x.d);
}

// The four pixels whose centres are around a place, which is held within those of the border: the first one,
// how far the others are from it, and how far the place is.
template <class S>
struct Footprint {
    decltype(whole(value_of(S{}))) first;
    int32_t across, down;
    S fx, fy;

    NMBG_INLINE Footprint(const S& u, const S& v, int32_t width, int32_t height)
        : across(width > 1 ? 1 : 0), down(height > 1 ? width : 0) {
        const auto column = place(u, width, fx), row = place(v, height, fy);
        first = row * width + column;
    }

    // Bilinear weight and offset of pixel n in [0, 4).
    NMBG_INLINE S weight(int n) const { return (n & 1 ? fx : T(1) - fx) * (n & 2 ? fy : T(1) - fy); }
    NMBG_INLINE Four<S> weights() const { return {weight(0), weight(1), weight(2), weight(3)}; }
    NMBG_INLINE auto offset(int n) const { return first + ((n & 2 ? down : 0) + (n & 1 ? across : 0)); }

  private:
    using V = decltype(value_of(S{}));
    using T = element_of<V>;

    // The pixel before a place on an axis of so many pixels; `distance` from its centre.
    NMBG_INLINE static auto place(const S& at, int32_t size, S& distance) {
        const S held = greatest_of<S>(least_of<S>(splat<S>(size - 1), at - T(0.5)), splat<S>(0));
        const auto before = whole(value_of(held));
        const auto pixel = least_of(before, splat<decltype(first)>(size > 1 ? size - 2 : 0));
        distance = held - number<V>(pixel);
        return pixel;
    }
};

// What the four pixels of a footprint hold, elements of the size of V's.
template <class V, class S>
NMBG_INLINE Four<V> four_of(const void* from, const Footprint<S>& four) {
    Four<V> held;
    gather_two(from, four.first, four.across, held.a, held.b);
    gather_two(from, four.first + four.down, four.across, held.c, held.d);
    return held;
}

// 1 on the surface that the photograph sees, 0 in front of it and behind.
template <class S, class V, class T>
NMBG_INLINE S visible(const S& z, const V& surface, T tolerance) {
    const auto known = surface > splat<V>(0);
    const V held = select(known, surface, splat<V>(1));
    const S share = within_unit<S>(T(2) - magnitude<S>(z - held) * (splat<V>(1) / (tolerance * held)));
    return select(known, share, splat<S>(0));
}

// Bilinear weights, as far as the pixels show the surface at depth z: their sum says how visible it is.
template <class S, class T, class Texel>
NMBG_INLINE Four<S> seen(const Photo<T, Texel>& photo, const BlendRule<T>& rule, const Footprint<S>& four,
                         const S& z) {
    using V = decltype(value_of(z));
    const Four<S> share = four.weights();
    const Four<V> surface = four_of<V>(photo.depth, four);
    return {share.a * visible(z, surface.a, rule.tolerance), share.b * visible(z, surface.b, rule.tolerance),
            share.c * visible(z, surface.c, rule.tolerance), share.d * visible(z, surface.d, rule.tolerance)};
}

// Weights of the four texels of the finest level in its colour. Only those of the visible surface count: what
// lies beyond an edge does not bleed.
template <class S, class T, class Texel>
NMBG_INLINE Four<S> finest_weights(const Photo<T, Texel>& photo, const BlendRule<T>& rule,
                                   const Footprint<S>& four, const S& z) {
    const Four<S> weight = seen(photo, rule, four, z);
    const S total = sum(weight), one = splat<S>(1);
    const S scale = one / select(total > splat<S>(0), total, one);
    return {scale * weight.a, scale * weight.b, scale * weight.c, scale * weight.d};
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
S level_for(const S& finer) {
    using std::log2;
    const S level = finer > S(1) ? log2(finer) - S(decltype(value_of(finer))(sharpness)) : S(0);
    return level > S(0) ? level : S(0);
}

// How much a level of a mip chain counts in a colour.
template <class S>
NMBG_INLINE S share_of(const MipLevel& mip, const S& level) {
    const S index = splat<S>(mip.index), one = splat<S>(1);
    const S share = within_unit<S>(one - magnitude<S>(level - index));
    return mip.last() ? select(level > index, one, share) : share;
}

// A texel's colour, of which `full` stands for 1.
template <class S>
struct Rgb {
    S red, green, blue;
    NMBG_INLINE friend Rgb operator*(const S& s, const Rgb& x) {
        return {s * x.red, s * x.green, s * x.blue};
    }
    NMBG_INLINE friend Rgb operator+(const Rgb& x, const Rgb& y) {
        return {x.red + y.red, x.green + y.green, x.blue + y.blue};
    }
};

template <class T, class Texel>
constexpr T full = T(std::is_same_v<Texel, uint8_t> ? 255 : 1);

// Of a word of four bytes.
template <class S, class I>
NMBG_INLINE Rgb<S> colour_of(const I& word) {
    static_assert(std::endian::native == std::endian::little);
    return {number<S>(word & 255), number<S>(word >> 8 & 255), number<S>(word >> 16 & 255)};
}

template <class T>
NMBG_INLINE Rgb<T> texel(const T* texels, int64_t i) {
    return {texels[4 * i], texels[4 * i + 1], texels[4 * i + 2]};
}
template <class T>
NMBG_INLINE Rgb<T> texel(const uint8_t* texels, int64_t i) {
    int32_t word;
    std::memcpy(&word, texels + 4 * i, sizeof word);
    return colour_of<T>(word);
}

}  // namespace nmbg::NMBG_ISA
