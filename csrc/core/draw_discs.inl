// See draw_discs.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

template <class T>
NMBG_INLINE void project_points(const T* h, int n, Points<T>& out) {
    constexpr T most = std::numeric_limits<T>::max();
    for (int i = 0; i < n; ++i) {
        const T x = h[3 * i], y = h[3 * i + 1], z = h[3 * i + 2];
        const bool drawn = (z > 0) & (z <= most) & (std::abs(x) <= most) & (std::abs(y) <= most);
        out.u[i] = x / z, out.v[i] = y / z, out.z[i] = drawn ? z : T(0);
    }
}

template <class T>
NMBG_INLINE void place_discs(const Points<T>& points, int n, double radius, const Level& level, Places& out) {
    const auto scale = static_cast<float>(level.scale), r = static_cast<float>(radius);
    for (int i = 0; i < n; i += wide) {
        const f32x8 u = scale * floats(load<eight<T>>(points.u + i));
        const f32x8 v = scale * floats(load<eight<T>>(points.v + i));
        const f32x8 z = floats(load<eight<T>>(points.z + i));
        Box<i32x8> box = pixels_within<f32x8>(u - r, v - r, u + r, v + r, level.width, level.height);
        box.x1 = select(z > 0, box.x1, box.x0);
        store_places(box, i32x8{}, [] NMBG_INLINE_LAMBDA { return i32x8{}; }, level.tiling, i, out);
    }
}

template <class T>
NMBG_INLINE void draw_any_discs(const Level& level, const PixelBox& tile, double radius,
                                std::span<const Disc<T>> discs, int32_t* index, T* dist2) {
    using V = eight<T>;
    alignas(64) T nearest[Tiling::pixels], apart[Tiling::pixels];
    alignas(64) int32_t point[Tiling::pixels];
    const int stride = level.tiling.stride();
    for (int i = 0; i < Tiling::pixels; i += wide) {
        store(splat<V>(std::numeric_limits<double>::infinity()), nearest + i);
        store(V{}, apart + i);
        store(splat<i32x8>(-1), point + i);
    }

    const auto r = static_cast<T>(radius), radius2 = static_cast<T>(radius * radius);
    const V half = V{0, 1, 2, 3, 4, 5, 6, 7} + T(0.5);
    for (const Disc<T>& disc : discs) {
        const auto reach =
            pixels_within<T>(disc.u - r, disc.v - r, disc.u + r, disc.v + r, level.width, level.height);
        const int x0 = greatest_of(reach.x0, tile.x0) - tile.x0, x1 = least_of(reach.x1, tile.x1) - tile.x0;
        const int y0 = greatest_of(reach.y0, tile.y0), y1 = least_of(reach.y1, tile.y1);
        for (int32_t y = y0; y < y1; ++y) {
            const T dy = disc.v - (static_cast<T>(y) + T(0.5));
            for (int column = x0 / wide * wide; column < x1; column += wide) {
                const V dx = disc.u - (half + static_cast<T>(tile.x0 + column));
                const V d2 = dx * dx + dy * dy;
                const int at = (y - tile.y0) * stride + column;
                const V before = load<V>(nearest + at);
                const auto wins = (d2 < radius2) & (disc.z < before);
                store(select(wins, V{} + disc.z, before), nearest + at);
                store(select(wins, d2, load<V>(apart + at)), apart + at);
                store(select(narrow(wins), i32x8{} + disc.point, load<i32x8>(point + at)), point + at);
            }
        }
    }

    for (int32_t y = tile.y0; y < tile.y1; ++y) {
        const int64_t pixel = level.first_pixel + int64_t{y} * level.width + tile.x0;
        const int at = (y - tile.y0) * stride, n = tile.x1 - tile.x0;
        std::copy_n(point + at, n, index + pixel);
        std::copy_n(apart + at, n, dist2 + pixel);
    }
}

inline void project(const float* h, int n, Points<float>& out) { project_points(h, n, out); }
inline void place(const Points<float>& points, int n, double radius, const Level& level, Places& out) {
    place_discs(points, n, radius, level, out);
}
inline void draw_discs(const Level& level, const PixelBox& box, double radius,
                       std::span<const Disc<float>> discs, int32_t* index, float* dist2) {
    draw_any_discs(level, box, radius, discs, index, dist2);
}

}  // namespace nmbg::NMBG_ISA
