// Eight numbers at a time, and boxes of pixels. Read once per instruction set, each time into a namespace of
// its own (each_isa.h): gcc takes such vectors apart for the set that the formula itself is compiled for, not
// for that of the function into which it is inlined. Formulas written with select(), splat() and whole() take
// single numbers as well.

namespace nmbg::NMBG_ISA {

constexpr int wide = 8;
using f64x8 = double __attribute__((vector_size(64)));
using i64x8 = int64_t __attribute__((vector_size(64)));
using f32x8 = float __attribute__((vector_size(32)));
using i32x8 = int32_t __attribute__((vector_size(32)));

template <class V, class E>
NMBG_INLINE V load(const E* from) {
    V v;
    std::memcpy(&v, from, sizeof v);
    return v;
}

template <class V, class E>
NMBG_INLINE void store(const V& v, E* to) {
    std::memcpy(to, &v, sizeof v);
}

// (from[at[0]], from[at[1]], …).
template <class V, class E>
NMBG_INLINE V gather(const E* from, const i32x8& at) {
#ifdef NMBG_AVX2
    if constexpr (std::is_same_v<E, float>) return (V)_mm256_i32gather_ps(from, (__m256i)at, 4);
#endif
    return V{from[at[0]], from[at[1]], from[at[2]], from[at[3]],
             from[at[4]], from[at[5]], from[at[6]], from[at[7]]};
}

template <class S>
NMBG_INLINE S splat(double x) {
    if constexpr (sizeof(S) <= 8)
        return static_cast<S>(x);
    else
        return S{} + static_cast<std::remove_cvref_t<decltype(S{}[0])>>(x);
}

template <class M, class S>
NMBG_INLINE S select(const M& mask, const S& a, const S& b) {
    return mask ? a : b;
}

template <class S>
NMBG_INLINE S least_of(const S& a, const S& b) {
    return select(b < a, b, a);
}
template <class S>
NMBG_INLINE S greatest_of(const S& a, const S& b) {
    return select(a < b, b, a);
}

// Of the three corners of triangles.
NMBG_INLINE f32x8 least_of(const f32x8* x) { return least_of(least_of(x[0], x[1]), x[2]); }
NMBG_INLINE f32x8 greatest_of(const f32x8* x) { return greatest_of(greatest_of(x[0], x[1]), x[2]); }

// Eight numbers of type T, and as doubles.
template <class T>
using eight = std::conditional_t<std::is_same_v<T, float>, f32x8, f64x8>;
NMBG_INLINE f64x8 doubles(const f32x8& x) { return __builtin_convertvector(x, f64x8); }
NMBG_INLINE f64x8 doubles(const f64x8& x) { return x; }
NMBG_INLINE f32x8 floats(const f32x8& x) { return x; }
NMBG_INLINE f32x8 floats(const f64x8& x) { return __builtin_convertvector(x, f32x8); }

// The whole numbers towards zero, and numbers from them.
template <class S>
NMBG_INLINE int32_t whole(S x) {
    return static_cast<int32_t>(x);
}
NMBG_INLINE i32x8 whole(const f32x8& x) { return __builtin_convertvector(x, i32x8); }
template <class S>
NMBG_INLINE S number(int32_t i) {
    return static_cast<S>(i);
}
template <class S>
NMBG_INLINE S number(const i32x8& i) {
    return __builtin_convertvector(i, S);
}
NMBG_INLINE i32x8 narrow(const i64x8& i) { return __builtin_convertvector(i, i32x8); }
NMBG_INLINE i32x8 narrow(const i32x8& i) { return i; }
// A mask for V's elements.
template <class V>
NMBG_INLINE auto mask_for(const i32x8& i) {
    if constexpr (sizeof(V) == sizeof(i32x8))
        return i;
    else
        return __builtin_convertvector(i, i64x8);
}

// A bit for each element of a mask, the lowest for the first.
NMBG_INLINE uint32_t bits_of(const i64x8& mask) {
#if defined(NMBG_AVX512)
    return _mm512_movepi64_mask((__m512i)mask);
#elif defined(NMBG_AVX2)
    const auto half = [](__m256d x) { return static_cast<uint32_t>(_mm256_movemask_pd(x)); };
    return half((__m256d)__builtin_shufflevector(mask, mask, 0, 1, 2, 3)) |
           half((__m256d)__builtin_shufflevector(mask, mask, 4, 5, 6, 7)) << 4;
#else
    uint32_t bits = 0;
    for (int i = 0; i < wide; ++i) bits |= static_cast<uint32_t>(mask[i] & 1) << i;
    return bits;
#endif
}
NMBG_INLINE uint32_t bits_of(const i32x8& mask) {
#if defined(NMBG_AVX2)
    return static_cast<uint32_t>(_mm256_movemask_ps((__m256)mask));
#else
    return bits_of(__builtin_convertvector(mask, i64x8));
#endif
}
template <class M>
NMBG_INLINE bool any_of(const M& mask) {
    return bits_of(mask) != 0;
}

NMBG_INLINE int32_t greatest_in(const i32x8& x) {
    using i32x4 = int32_t __attribute__((vector_size(16)));
    const i32x4 four = greatest_of<i32x4>(__builtin_shufflevector(x, x, 0, 1, 2, 3),
                                          __builtin_shufflevector(x, x, 4, 5, 6, 7));
    const i32x4 two = greatest_of<i32x4>(four, __builtin_shufflevector(four, four, 2, 3, 0, 1));
    return two[0] > two[1] ? two[0] : two[1];
}

// The greatest of many numbers, whole vectors of them.
template <class V, class Array>
NMBG_INLINE auto greatest_of_all(const Array& x) {
    V most = load<V>(x.data());
    for (std::size_t i = wide; i < x.size(); i += wide) most = greatest_of(most, load<V>(x.data() + i));
    auto greatest = most[0];
    for (int i = 1; i < wide; ++i) greatest = std::max(greatest, most[i]);
    return greatest;
}

// Writes (x[0], y[0], z[0], x[1], …).
template <class V, class E>
NMBG_INLINE void store_interleaved(const V& x, const V& y, const V& z, E* to) {
    const V xy0 = __builtin_shufflevector(x, y, 0, 8, -1, 1, 9, -1, 2, 10);
    const V xy1 = __builtin_shufflevector(x, y, -1, 3, 11, -1, 4, 12, -1, 5);
    const V xy2 = __builtin_shufflevector(x, y, 13, -1, 6, 14, -1, 7, 15, -1);
    store(__builtin_shufflevector(xy0, z, 0, 1, 8, 3, 4, 9, 6, 7), to);
    store(__builtin_shufflevector(xy1, z, 10, 1, 2, 11, 4, 5, 12, 7), to + wide);
    store(__builtin_shufflevector(xy2, z, 0, 13, 2, 3, 14, 5, 6, 15), to + 2 * wide);
}

// As PixelBox, one or eight.
template <class I>
struct Box {
    I x0{}, y0{}, x1{}, y1{};
};

// The first pixel of [0, size] whose centre is beyond `x`; x may be infinite, what is no number counts as −∞.
template <class S>
NMBG_INLINE auto first_pixel_beyond(const S& x, int32_t size) {
    const S next = x + splat<S>(0.5), last = splat<S>(size), zero = splat<S>(0);
    const S above = select(next > zero, next, zero);
    return whole(select(above < last, above, last));
}

// Pixels: wider than what float coordinates of so many pixels round by, narrower than what would slow the
// exact tests down that follow.
NMBG_INLINE float margin_of(int32_t width, int32_t height) {
    return 1.0f / 256 + 0x1p-22f * static_cast<float>(width > height ? width : height);
}

// The pixels of a width × height image whose centres lie in [xmin, xmax] × [ymin, ymax], or a little beyond.
template <class S>
NMBG_INLINE auto pixels_within(const S& xmin, const S& ymin, const S& xmax, const S& ymax, int32_t width,
                               int32_t height) {
    const S margin = splat<S>(margin_of(width, height));
    return Box<decltype(whole(xmin))>{
        first_pixel_beyond<S>(xmin - margin, width), first_pixel_beyond<S>(ymin - margin, height),
        first_pixel_beyond<S>(xmax + margin, width), first_pixel_beyond<S>(ymax + margin, height)};
}

}  // namespace nmbg::NMBG_ISA
