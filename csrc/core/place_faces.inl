// See place_faces.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

template <class T>
NMBG_INLINE void project_any(const T* h, int64_t n, Screen* screen) {
    constexpr T most = std::numeric_limits<T>::max(), nowhere = std::numeric_limits<T>::quiet_NaN();
    for (int64_t i = 0; i < n; ++i) {
        const T x = h[3 * i], y = h[3 * i + 1], z = h[3 * i + 2];
        const bool drawn = (z > 0) & (z <= most) & (std::abs(x) <= most) & (std::abs(y) <= most);
        screen[i] = {static_cast<float>(drawn ? x / z : nowhere), static_cast<float>(drawn ? y / z : nowhere)};
    }
}

inline void project(const float* h, int64_t n, Screen* screen) { project_any(h, n, screen); }

// Reads and writes whole vectors: beyond n, the last face again.
inline bool measure(const Screen* screen, uint32_t last, const int32_t* faces, int n, Extents& out) {
    uint32_t highest = 0;
    for (int first = 0; first < n; first += wide) {
        float u[3][wide], v[3][wide];
        for (int i = 0; i < wide; ++i) {
            const int32_t* face = faces + 3 * (first + i < n ? first + i : n - 1);
            for (int k = 0; k < 3; ++k) {
                const auto vertex = static_cast<uint32_t>(face[k]);
                highest = highest > vertex ? highest : vertex;
                const Screen& at = screen[vertex < last ? vertex : last];
                u[k][i] = at.u, v[k][i] = at.v;
            }
        }
        const f32x8 u0 = load<f32x8>(u[0]), u1 = load<f32x8>(u[1]), u2 = load<f32x8>(u[2]);
        const f32x8 v0 = load<f32x8>(v[0]), v1 = load<f32x8>(v[1]), v2 = load<f32x8>(v[2]);
        const f32x8 sum = u0 + u1 + u2;
        store(select(sum == sum, least_of(least_of(u0, u1), u2), sum), out.umin + first);
        store(least_of(least_of(v0, v1), v2), out.vmin + first);
        store(greatest_of(greatest_of(u0, u1), u2), out.umax + first);
        store(greatest_of(greatest_of(v0, v1), v2), out.vmax + first);
    }
    return highest <= last;
}

template <class S>
NMBG_INLINE auto box_at(const Extents& e, int i, const Level& level) {
    const S scale = splat<S>(level.scale);
    return pixels_within<S>(scale * load<S>(e.umin + i), scale * load<S>(e.vmin + i),
                            scale * load<S>(e.umax + i), scale * load<S>(e.vmax + i), level.width,
                            level.height);
}

inline void place(const Extents& extents, int n, const Level& level, int32_t* holder) {
    const Tiling& tiling = level.tiling;
    const int down = tiling.log_height(), across = tiling.log_width(), columns = tiling.columns();
    for (int i = 0; i < n; i += wide) {
        const Box<i32x8> box = box_at<f32x8>(extents, i, level);
        const i32x8 first = (box.y0 >> down) * columns + (box.x0 >> across);
        const i32x8 last = ((box.y1 - 1) >> down) * columns + ((box.x1 - 1) >> across);
        const i32x8 one = select(first == last, first, splat<i32x8>(several_tiles));
        const i32x8 known = select((box.x0 >= box.x1) | (box.y0 >= box.y1), splat<i32x8>(no_tile), one);
        const f32x8 umin = load<f32x8>(extents.umin + i);
        store(select(umin == umin, known, splat<i32x8>(several_tiles)), holder + i);
    }
}

}  // namespace nmbg::NMBG_ISA
