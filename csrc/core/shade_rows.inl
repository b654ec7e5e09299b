// See shade_rows.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

constexpr int strip = 64;  // pixels whose features are written together
constexpr int ahead = 8;   // pixels by which rows are asked for before they are mixed

// Ask for the rows of a pixel: their order in memory is not one that the processor foresees.
template <int K, class T>
NMBG_INLINE void fetch(const Shading<T>& s, int64_t pixel, int size) {
    std::array<int32_t, K> vertex{};
    if (!corners<K>(s, pixel, vertex)) return;
    for (int k = 0; k < K; ++k) {
        const char* row = reinterpret_cast<const char*>(s.coeffs + int64_t{vertex[k]} * size);
        for (size_t byte = 0; byte < size * sizeof(T); byte += 64) __builtin_prefetch(row + byte);
    }
}

// row = Σ_k weight_k rows_k.
template <int K, class T>
NMBG_INLINE void mix(const T* const* rows, const T* weight, int size, T* row) {
    using V = eight<T>;
    const auto at = [&](int i) NMBG_INLINE_LAMBDA {
        V sum = weight[0] * load<V>(rows[0] + i);
        for (int k = 1; k < K; ++k) sum += weight[k] * load<V>(rows[k] + i);
        store(sum, row + i);
    };
    if (size >= wide) {
        for (int i = 0; i < size - wide; i += wide) at(i);
        at(size - wide);  // overlaps the one before, with the same numbers
    } else {
        for (int i = 0; i < size; ++i) {
            row[i] = 0;
            for (int k = 0; k < K; ++k) row[i] += weight[k] * rows[k][i];
        }
    }
}

// feature_c = Σ_b Y_b row[b, c].
template <int B, class T>
NMBG_INLINE void contract(const T* Y, const T* row, int channels, T* feature) {
    using V = eight<T>;
    int c = 0;
    for (; c + wide <= channels; c += wide) {
        V sum = Y[0] * load<V>(row + c);
        for (int b = 1; b < B; ++b) sum += Y[b] * load<V>(row + b * channels + c);
        store(sum, feature + c);
    }
    for (; c < channels; ++c) {
        T sum = Y[0] * row[c];
        for (int b = 1; b < B; ++b) sum += Y[b] * row[b * channels + c];
        feature[c] = sum;
    }
}

template <int K, int B, class T>
NMBG_INLINE void shade_any_pixels(const Shading<T>& s, int64_t begin, int64_t end, T* out) {
    const int size = B * s.channels;
    std::vector<T> buffer(size + strip * s.channels);
    T *row = buffer.data(), *features = row + size;
    for (int64_t first = begin; first < end; first += strip) {
        const int n = static_cast<int>(end - first < strip ? end - first : strip);
        for (int i = 0; i < n; ++i) {
            const int64_t pixel = first + i;
            if (pixel + ahead < end) fetch<K>(s, pixel + ahead, size);
            T* feature = features + i * s.channels;
            std::array<int32_t, K> vertex{};
            if (!corners<K>(s, pixel, vertex)) {
                for (int c = 0; c < s.channels; ++c) feature[c] = 0;
                continue;
            }
            const T* rows[K];
            for (int k = 0; k < K; ++k) rows[k] = s.coeffs + int64_t{vertex[k]} * size;
            T Y[B];
            harmonics<B>(s.rays + 3 * pixel, Y);
            mix<K>(rows, s.weight + K * pixel, size, row);
            contract<B>(Y, row, s.channels, feature);
        }
        for (int c = 0; c < s.channels; ++c)
            for (int i = 0; i < n; ++i) out[c * s.pixels + first + i] = features[i * s.channels + c];
    }
}

template <int K, int B, class T>
NMBG_INLINE void add_any_pixels(const Shading<T>& s, const T* grad, std::span<const int32_t> pixels,
                                int64_t first, int64_t end, T* grad_coeffs) {
    using V = eight<T>;
    const int channels = s.channels, size = B * channels;
    std::vector<T> product(size);
    for (const int32_t pixel : pixels) {
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
