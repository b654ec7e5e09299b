// Eight numbers at a time, or as many as the processor takes at once, and boxes of pixels. Read once per
// instruction set, each time into a namespace of its own (each_isa.h): gcc takes such vectors apart for the
// set that the formula itself is compiled for, not for that of the function into which it is inlined.
// Formulas written with select(), splat() and whole() take single numbers as well.

namespace nmbg::NMBG_ISA {

// n numbers of type T.
template <class T, int n>
struct VectorOf {
    typedef T type __attribute__((vector_size(n * sizeof(T))));
};
template <class T, int n>
using vector_of = typename VectorOf<T, n>::type;

// How many numbers of type T the processor takes at once.
#if defined(NMBG_AVX512)
template <class T>
constexpr int abreast = 64 / sizeof(T);
#elif defined(NMBG_AVX2)
template <class T>
constexpr int abreast = 32 / sizeof(T);
#else
template <class T>
constexpr int abreast = 16 / sizeof(T);
#endif

constexpr int wide = 8;
using f64x8 = vector_of<double, wide>;
using i64x8 = vector_of<int64_t, wide>;
using f32x8 = vector_of<float, wide>;
using i32x8 = vector_of<int32_t, wide>;

// The type of a vector's numbers, or of the number that V is, and how many they are.
template <class V>
NMBG_INLINE auto first_of(const V& x) {
    if constexpr (std::is_arithmetic_v<V>)
        return x;
    else
        return x[0];
}
template <class V>
using element_of = decltype(first_of(V{}));
template <class V>
constexpr int width_of = sizeof(V) / sizeof(element_of<V>);

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
template <class V, class E, class I>
NMBG_INLINE V gather(const E* from, const I& at) {
#ifdef NMBG_AVX512
    if constexpr (std::is_same_v<V, vector_of<float, 16>>)
        return (V)_mm512_mask_i32gather_ps(_mm512_setzero_ps(), 0xffff, (__m512i)at, from, 4);
#endif
#ifdef NMBG_AVX2
    if constexpr (std::is_same_v<V, f32x8>) return (V)_mm256_i32gather_ps(from, (__m256i)at, 4);
#endif
    V v;
    for (int i = 0; i < width_of<V>; ++i) v[i] = from[at[i]];
    return v;
}

// Writes v[i] to to[at[i]].
template <class V, class E, class I>
NMBG_INLINE void scatter(const V& v, E* to, const I& at) {
#ifdef NMBG_AVX512
    if constexpr (std::is_same_v<V, vector_of<float, 16>>)
        return _mm512_i32scatter_ps(to, (__m512i)at, (__m512)v, 4);
#endif
    for (int i = 0; i < width_of<V>; ++i) to[at[i]] = v[i];
}

// Elements at[i] and at[i] + step, of the size of V's; V and I are single numbers or vectors.
template <class V, class I>
NMBG_INLINE void gather_two(const void* from, const I& at, int32_t step, V& first, V& second) {
    if constexpr (std::is_arithmetic_v<I>) {
        std::memcpy(&first, static_cast<const V*>(from) + at, sizeof(V));
        std::memcpy(&second, static_cast<const V*>(from) + at + step, sizeof(V));
    } else {
        // Neighbours come in one read.
#if defined(NMBG_AVX512)
        if constexpr (width_of<V> == 16 && sizeof(element_of<V>) == 4)
            if (step == 1) {
                const auto low = __builtin_shufflevector(at, at, 0, 1, 2, 3, 4, 5, 6, 7),
                           high = __builtin_shufflevector(at, at, 8, 9, 10, 11, 12, 13, 14, 15);
                const __m512i none = _mm512_setzero_si512();  // gcc warns of the forms that take none
                const V a = (V)_mm512_mask_i32gather_epi64(none, 255, (__m256i)low, from, 4),
                        b = (V)_mm512_mask_i32gather_epi64(none, 255, (__m256i)high, from, 4);
                first =
                    __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
                second =
                    __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
                return;
            }
#elif defined(NMBG_AVX2)
        if constexpr (width_of<V> == 8 && sizeof(element_of<V>) == 4)
            if (step == 1) {
                const auto pairs = static_cast<const long long*>(from);
                const auto low = __builtin_shufflevector(at, at, 0, 1, 2, 3),
                           high = __builtin_shufflevector(at, at, 4, 5, 6, 7);
                const V a = (V)_mm256_i32gather_epi64(pairs, (__m128i)low, 4),
                        b = (V)_mm256_i32gather_epi64(pairs, (__m128i)high, 4);
                first = __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14);
                second = __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15);
                return;
            }
#endif
        for (int i = 0; i < width_of<V>; ++i) {
            element_of<V> one, other;
            gather_two(from, at[i], step, one, other);
            first[i] = one, second[i] = other;
        }
    }
}

template <class S, class N>
NMBG_INLINE S splat(N x) {
    if constexpr (std::is_arithmetic_v<S> || std::is_class_v<S>)
        return static_cast<S>(x);
    else
        return S{} + static_cast<element_of<S>>(x);
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
NMBG_INLINE auto whole(const S& x) {
    if constexpr (std::is_arithmetic_v<S>)
        return static_cast<int32_t>(x);
    else
        return __builtin_convertvector(x, vector_of<int32_t, width_of<S>>);
}
template <class S, class I>
NMBG_INLINE S number(const I& i) {
    if constexpr (std::is_arithmetic_v<I>)
        return static_cast<S>(i);
    else
        return __builtin_convertvector(i, S);
}

// A mask of 4-byte elements.
template <class I>
NMBG_INLINE auto narrow(const I& i) {
    return __builtin_convertvector(i, vector_of<int32_t, width_of<I>>);
}
// A mask for V's elements.
template <class V>
NMBG_INLINE auto mask_for(const i32x8& i) {
    if constexpr (sizeof(V) == sizeof(i32x8))
        return i;
    else
        return __builtin_convertvector(i, i64x8);
}

// A bit for each element of a mask, the lowest for the first.
template <class M>
NMBG_INLINE uint32_t bits_of(const M& mask) {
#if defined(NMBG_AVX512)
    if constexpr (sizeof(M) == 64)
        return sizeof(element_of<M>) == 8 ? _mm512_movepi64_mask((__m512i)mask)
                                          : _mm512_movepi32_mask((__m512i)mask);
#elif defined(NMBG_AVX2)
    if constexpr (std::is_same_v<M, i64x8>) {
        const auto half = [](__m256d x) { return static_cast<uint32_t>(_mm256_movemask_pd(x)); };
        return half((__m256d)__builtin_shufflevector(mask, mask, 0, 1, 2, 3)) |
               half((__m256d)__builtin_shufflevector(mask, mask, 4, 5, 6, 7)) << 4;
    }
#endif
#if defined(NMBG_AVX2)
    if constexpr (std::is_same_v<M, i32x8>) return static_cast<uint32_t>(_mm256_movemask_ps((__m256)mask));
#endif
    uint32_t bits = 0;
    for (int i = 0; i < width_of<M>; ++i) bits |= static_cast<uint32_t>(mask[i] & 1) << i;
    return bits;
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
