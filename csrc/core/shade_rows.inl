// See shade_rows.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

constexpr int strip = 64;  // pixels whose features are written together
constexpr int ahead = 8;   // pixels by which rows are asked for before they are mixed; a power of two

// Asks for the rows of the corners: their order in memory is not one that the processor foresees.
template <int K, class T>
NMBG_INLINE void fetch(const T* const* rows, int size) {
    for (int k = 0; k < K; ++k)
        for (std::size_t byte = 0; byte < size * sizeof(T); byte += 64)
            __builtin_prefetch(reinterpret_cast<const char*>(rows[k]) + byte);
}

// Eight numbers from i on of Σ_k weight_k rows_k.
template <int K, class T>
NMBG_INLINE eight<T> mixed(const T* const* rows, const T* weight, int i) {
    using V = eight<T>;
    V sum = weight[0] * load<V>(rows[0] + i);
    for (int k = 1; k < K; ++k) sum += weight[k] * load<V>(rows[k] + i);
    return sum;
}

// feature_c = Σ_b Y_b Σ_k weight_k rows_k[b, c]; the Y_b of a pixel stand `strip` apart.
template <int K, int B, class T>
NMBG_INLINE void contract(const T* const* rows, const T* weight, const T* Y, int channels, T* feature) {
    using V = eight<T>;
    const auto eight_channels = [&](int c) NMBG_INLINE_LAMBDA {
        V sum = Y[0] * mixed<K>(rows, weight, c);
        for (int b = 1; b < B; ++b) sum += Y[b * strip] * mixed<K>(rows, weight, b * channels + c);
        store(sum, feature + c);
    };
    if (channels >= wide) {
        for (int c = 0; c < channels - wide; c += wide) eight_channels(c);
        return eight_channels(channels - wide);  // overlaps the one before, with the same numbers
    }
    for (int c = 0; c < channels; ++c) {
        feature[c] = 0;
        for (int b = 0; b < B; ++b) {
            T sum = weight[0] * rows[0][b * channels + c];
            for (int k = 1; k < K; ++k) sum += weight[k] * rows[k][b * channels + c];
            feature[c] += Y[b * strip] * sum;
        }
    }
}

// The same for nine functions of three channels: two functions at a time, and the last one in lanes 5 to 7.
template <int K, class T>
NMBG_INLINE void contract_colours(const T* const* rows, const T* weight, const T* Y, T* feature) {
    using V = eight<T>;
    constexpr decltype(V{} < V{}) second{0, 0, 0, -1, -1, -1, 0, 0};
    const auto pair = [&](int b) NMBG_INLINE_LAMBDA {
        return select(second, V{} + Y[(b + 1) * strip], V{} + Y[b * strip]) * mixed<K>(rows, weight, 3 * b);
    };
    const V sum = pair(0) + pair(2) + pair(4) + pair(6), last = Y[8 * strip] * mixed<K>(rows, weight, 19);
    for (int c = 0; c < 3; ++c) feature[c] = sum[c] + sum[c + 3] + last[c + 5];
}

template <int K, int B, int C, class T>
NMBG_INLINE void shade_strips(const Shading<T>& s, int64_t begin, int64_t end, T* out) {
    const int channels = C ? C : s.channels, size = B * channels;
    std::vector<T> buffer(strip * channels);
    T* features = buffer.data();
    const T* rows[ahead][K];  // of the pixels that follow; the first is null where one is empty
    const auto ask = [&](int64_t pixel) NMBG_INLINE_LAMBDA {
        if (K > 1 && pixel + ahead < end) __builtin_prefetch(s.faces + K * int64_t{s.index[pixel + ahead]});
        std::array<int32_t, K> vertex{};
        const T** at = rows[pixel % ahead];
        at[0] = nullptr;
        if (!corners<K>(s, pixel, vertex)) return;
        for (int k = 0; k < K; ++k) at[k] = s.coeffs + int64_t{vertex[k]} * size;
        fetch<K>(at, size);
    };
    for (int64_t pixel = begin; pixel < end && pixel < begin + ahead; ++pixel) ask(pixel);
    for (int64_t first = begin; first < end; first += strip) {
        const int n = static_cast<int>(end - first < strip ? end - first : strip);
        T Y[B][strip];
#pragma omp simd
        for (int i = 0; i < n; ++i) {
            T of_pixel[B];
            harmonics<B>(s.rays + 3 * (first + i), of_pixel);
            for (int b = 0; b < B; ++b) Y[b][i] = of_pixel[b];
        }
        for (int i = 0; i < n; ++i) {
            const int64_t pixel = first + i;
            T* feature = features + i * channels;
            const T* const* at = rows[pixel % ahead];
            if (!at[0])
                for (int c = 0; c < channels; ++c) feature[c] = 0;
            else if constexpr (B == 9 && C == 3)
                contract_colours<K>(at, s.weight + K * pixel, &Y[0][i], feature);
            else
                contract<K, B>(at, s.weight + K * pixel, &Y[0][i], channels, feature);
            if (pixel + ahead < end) ask(pixel + ahead);
        }
        for (int c = 0; c < channels; ++c)
            for (int i = 0; i < n; ++i) out[c * s.pixels + first + i] = features[i * channels + c];
    }
}

template <int K, int B, int C, class T>
NMBG_INLINE void add_rows(const Shading<T>& s, const T* grad, std::span<const int32_t> pixels, int64_t first,
                          int64_t end, T* grad_coeffs) {
    using V = eight<T>;
    const int channels = C ? C : s.channels, size = B * channels;
    std::vector<T> product(size);
    for (std::size_t at = 0; at < pixels.size(); ++at) {
        const int32_t pixel = pixels[at];
        if (at + 2 * ahead < pixels.size()) {
            const int64_t far = pixels[at + 2 * ahead], near = pixels[at + ahead];
            __builtin_prefetch(s.index + far);
            if (K > 1) __builtin_prefetch(s.faces + K * int64_t{s.index[near]});
            __builtin_prefetch(s.weight + K * near), __builtin_prefetch(s.rays + 3 * near);
            __builtin_prefetch(grad + near * channels);
        }
        std::array<int32_t, K> vertex{};
        corners<K>(s, pixel, vertex);
        T Y[B];
        harmonics<B>(s.rays + 3 * int64_t{pixel}, Y);
        const T* g = grad + int64_t{pixel} * channels;
        for (int b = 0; b < B; ++b)
            for (int c = 0; c < channels; ++c) product[b * channels + c] = Y[b] * g[c];
        for (int k = 0; k < K; ++k) {
            if (vertex[k] < first || vertex[k] >= end) continue;
            T* row = grad_coeffs + int64_t{vertex[k]} * size;
            const T weight = s.weight[K * int64_t{pixel} + k];
            int i = 0;
            for (; i + wide <= size; i += wide)
                store(load<V>(row + i) + weight * load<V>(product.data() + i), row + i);
            for (; i < size; ++i) row[i] += weight * product[i];
        }
    }
}

// Calls body.template operator()<C>() for the number of channels; 0 where it is not one of the common ones.
template <class Body>
NMBG_INLINE void with_channels(int channels, const Body& body) {
    switch (channels) {
        case 3:
            return body.template operator()<3>();
        case 8:
            return body.template operator()<8>();
        default:
            return body.template operator()<0>();
    }
}

template <int K, int B, class T>
NMBG_INLINE void shade_any_pixels(const Shading<T>& s, int64_t begin, int64_t end, T* out) {
    with_channels(s.channels, [&]<int C>() { shade_strips<K, B, C>(s, begin, end, out); });
}

template <int K, int B, class T>
NMBG_INLINE void add_any_pixels(const Shading<T>& s, const T* grad, std::span<const int32_t> pixels,
                                int64_t first, int64_t end, T* grad_coeffs) {
    with_channels(s.channels, [&]<int C>() { add_rows<K, B, C>(s, grad, pixels, first, end, grad_coeffs); });
}

template <int K, int B>
void shade_pixels(const Shading<float>& s, int64_t begin, int64_t end, float* out) {
    shade_any_pixels<K, B>(s, begin, end, out);
}

template <int K, int B>
void add_pixels(const Shading<float>& s, const float* grad, std::span<const int32_t> pixels, int64_t first,
                int64_t end, float* grad_coeffs) {
    add_any_pixels<K, B>(s, grad, pixels, first, end, grad_coeffs);
}

}  // namespace nmbg::NMBG_ISA
