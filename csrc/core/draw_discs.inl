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

// Eight points in their cells, and which of them are in any.
struct InCells {
    i32x8 inside, cell;
};
NMBG_INLINE InCells in_cells(const f32x8& u, const f32x8& v, const Cells& cells) {
    const f32x8 x = u * cells.per_pixel, y = v * cells.per_pixel;
    const i32x8 inside =
        (x >= 0) & (y >= 0) & (x < static_cast<float>(cells.width)) & (y < static_cast<float>(cells.height));
    return {inside, whole(select(inside, y, f32x8{})) * cells.width + whole(select(inside, x, f32x8{}))};
}

template <class T>
NMBG_INLINE void keep_any_nearest(const Points<T>& points, int n, Cells& cells) {
    for (int i = 0; i < n; i += wide) {
        const f32x8 z = floats(load<eight<T>>(points.z + i));
        const auto [inside, cell] =
            in_cells(floats(load<eight<T>>(points.u + i)), floats(load<eight<T>>(points.v + i)), cells);
        for (unsigned seen = bits_of(inside & (z > 0)) & (0xffu >> std::max(0, i + wide - n)); seen;
             seen &= seen - 1) {
            const int lane = std::countr_zero(seen);
            float* nearest = &cells.z[cell[lane]];
            float before;
            __atomic_load(nearest, &before, __ATOMIC_RELAXED);
            float depth = z[lane];
            if (depth < before) __atomic_store(nearest, &depth, __ATOMIC_RELAXED);
        }
    }
}

template <class T>
NMBG_INLINE void place_discs(const Points<T>& points, int n, double radius, const Level& level,
                             const Cells* hidden, Places& out) {
    const auto scale = static_cast<float>(level.scale), r = static_cast<float>(radius);
    for (int i = 0; i < n; i += wide) {
        const f32x8 finest_u = floats(load<eight<T>>(points.u + i)), u = scale * finest_u;
        const f32x8 finest_v = floats(load<eight<T>>(points.v + i)), v = scale * finest_v;
        const f32x8 z = floats(load<eight<T>>(points.z + i));
        i32x8 drawn = z > 0;
        if (hidden) {
            const auto [inside, cell] = in_cells(finest_u, finest_v, *hidden);
            drawn &= ~(inside & (z > gather<f32x8>(hidden->z.data(), cell)));
            if (!any_of(drawn)) {
                out.drawn[i / wide] = 0;
                continue;
            }
        }
        Box<i32x8> box = pixels_within<f32x8>(u - r, v - r, u + r, v + r, level.width, level.height);
        box.x1 = select(drawn, box.x1, box.x0);
        // For the rounding of z in float.
        const auto nearest = [&]() NMBG_INLINE_LAMBDA { return z * (1 - 0x1p-20f); };
        store_places(
            box, i32x8{}, []() NMBG_INLINE_LAMBDA { return i32x8{}; }, nearest, level.tiling, i, out);
    }
}

template <class T>
NMBG_INLINE void draw_any_discs(const PointsView<T>& view, const Level& level, const PixelBox& tile,
                                std::span<Run> runs, int32_t* index, T* dist2) {
    using V = eight<T>;
    alignas(64) std::array<T, Tiling::pixels> nearest, apart;
    alignas(64) std::array<int32_t, Tiling::pixels> point;
    const int stride = level.tiling.stride();
    clear(nearest, tile, stride), apart.fill(0), point.fill(-1);

    const auto radius2 = static_cast<T>(view.radius * view.radius);
    const auto scale = static_cast<T>(level.scale);
    const f32x8 r = splat<f32x8>(view.radius);
    const V centres = V{0, 1, 2, 3, 4, 5, 6, 7} + T(0.5);
    const auto ask = [&](int32_t point)
                         NMBG_INLINE_LAMBDA { __builtin_prefetch(view.h + 3 * int64_t{point}); };
    const auto fetch = [](const int32_t*) {};
    const auto draw = [&](const int32_t* points) NMBG_INLINE_LAMBDA {
        const i32x8 at_h = 3 * load<i32x8>(points);
        const V z = gather<V>(view.h, at_h + 2);
        const V u = gather<V>(view.h, at_h) / z * scale, v = gather<V>(view.h, at_h + 1) / z * scale;
        const f32x8 fu = floats(u), fv = floats(v);
        const Box<i32x8> reach =
            pixels_within<f32x8>(fu - r, fv - r, fu + r, fv + r, level.width, level.height);
        for (uint32_t some = bits_of(z > 0); some; some &= some - 1) {
            const int i = std::countr_zero(some);
            const int x0 = std::max(reach.x0[i], tile.x0) - tile.x0,
                      x1 = std::min(reach.x1[i], tile.x1) - tile.x0;
            const int y0 = std::max(reach.y0[i], tile.y0), y1 = std::min(reach.y1[i], tile.y1);
            const V x = V{} + u[i], depth = V{} + z[i];
            const i32x8 item = i32x8{} + points[i];
            for (int32_t y = y0; y < y1; ++y) {
                const T dy = v[i] - (static_cast<T>(y) + T(0.5));
                for (int column = x0 / wide * wide; column < x1; column += wide) {
                    const V dx = x - (centres + static_cast<T>(tile.x0 + column));
                    const V d2 = dx * dx + dy * dy;
                    const int at = (y - tile.y0) * stride + column;
                    const V before = load<V>(&nearest[at]);
                    const i32x8 holder = load<i32x8>(&point[at]);
                    const auto wins = narrow(d2 < radius2) &
                                      (narrow(depth < before) | (narrow(depth == before) & (item < holder)));
                    store(select(mask_for<V>(wins), depth, before), &nearest[at]);
                    store(select(mask_for<V>(wins), d2, load<V>(&apart[at])), &apart[at]);
                    store(select(wins, item, holder), &point[at]);
                }
            }
        }
    };
    front_to_back(runs, [&]() NMBG_INLINE_LAMBDA { return greatest_of_all<V>(nearest); }, ask, fetch, draw);

    for (int32_t y = tile.y0; y < tile.y1; ++y) {
        const int64_t pixel = level.first_pixel + int64_t{y} * level.width + tile.x0;
        const int at = (y - tile.y0) * stride, n = tile.x1 - tile.x0;
        std::copy_n(&point[at], n, index + pixel);
        std::copy_n(&apart[at], n, dist2 + pixel);
    }
}

inline void project(const float* h, int n, Points<float>& out) { project_points(h, n, out); }
inline void keep_nearest(const Points<float>& points, int n, Cells& cells) {
    keep_any_nearest(points, n, cells);
}
inline void place(const Points<float>& points, int n, double radius, const Level& level, const Cells* hidden,
                  Places& out) {
    place_discs(points, n, radius, level, hidden, out);
}
inline void draw_discs(const PointsView<float>& view, const Level& level, const PixelBox& box,
                       std::span<Run> runs, int32_t* index, float* dist2) {
    draw_any_discs(view, level, box, runs, index, dist2);
}

}  // namespace nmbg::NMBG_ISA
