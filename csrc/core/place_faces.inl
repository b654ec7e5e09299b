// See place_faces.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

template <class T>
NMBG_INLINE void project_any(const T* h, int64_t n, Screen* screen) {
    constexpr T most = std::numeric_limits<T>::max(), nowhere = std::numeric_limits<T>::quiet_NaN();
    for (int64_t i = 0; i < n; ++i) {
        const T x = h[3 * i], y = h[3 * i + 1], z = h[3 * i + 2];
        const bool drawn = (z > 0) & (z <= most) & (std::abs(x) <= most) & (std::abs(y) <= most);
        screen[i] = {static_cast<float>(drawn ? x / z : nowhere),
                     static_cast<float>(drawn ? y / z : nowhere)};
    }
}

inline void project(const float* h, int64_t n, Screen* screen) { project_any(h, n, screen); }

// Reads and writes whole vectors: beyond n, the last face again.
inline bool outline(const Screen* screen, int32_t last, const int32_t* faces, int n, Outlines& out) {
    i32x8 wrong{};
    for (int first = 0; first < n; first += wide) {
        const i32x8 index = first + i32x8{0, 1, 2, 3, 4, 5, 6, 7};
        const i32x8 face = 3 * select(index < n, index, splat<i32x8>(n - 1));
        for (int k = 0; k < 3; ++k) {
            const i32x8 vertex = gather<i32x8>(faces, face + k);
            const i32x8 bad = (vertex < 0) | (vertex > last);
            wrong |= bad;
            const i32x8 at = 2 * select(bad, splat<i32x8>(0), vertex);
            store(gather<f32x8>(&screen->u, at), out.u[k] + first);
            store(gather<f32x8>(&screen->u, at + 1), out.v[k] + first);
        }
    }
    return !any_of(wrong);
}

// Whether any of the 2 × 2 pixels from (x0, y0) on may be inside a triangle of the image, up to `margin` px.
NMBG_INLINE i32x8 may_cover(const f32x8* u, const f32x8* v, const i32x8& x0, const i32x8& y0, float margin) {
    const f32x8 x = number<f32x8>(x0) + 0.5f, y = number<f32x8>(y0) + 0.5f, zero{};
    const f32x8 area = (u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0]);
    const f32x8 turn = select(area < zero, splat<f32x8>(-1), splat<f32x8>(1));
    f32x8 e[3], right[3], below[3];
    for (int k = 0; k < 3; ++k) {
        const f32x8 du = turn * (u[(k + 1) % 3] - u[k]), dv = turn * (v[(k + 1) % 3] - v[k]);
        const f32x8 slack = margin * (greatest_of(du, -du) + greatest_of(dv, -dv));
        e[k] = du * (y - v[k]) - dv * (x - u[k]) + slack;
        right[k] = -dv, below[k] = du;
    }
    const auto inside = [](const f32x8& e0, const f32x8& e1, const f32x8& e2)
                            NMBG_INLINE_LAMBDA { return ~(least_of(least_of(e0, e1), e2) < f32x8{}); };
    i32x8 any = inside(e[0], e[1], e[2]) | inside(e[0] + right[0], e[1] + right[1], e[2] + right[2]);
    for (int k = 0; k < 3; ++k) e[k] += below[k];
    any |= inside(e[0], e[1], e[2]) | inside(e[0] + right[0], e[1] + right[1], e[2] + right[2]);
    return any;
}

inline void place(const Outlines& outlines, int n, const Level& level, Places& out) {
    const auto scale = static_cast<float>(level.scale);
    for (int i = 0; i < n; i += wide) {
        f32x8 u[3], v[3];
        for (int k = 0; k < 3; ++k)
            u[k] = scale * load<f32x8>(outlines.u[k] + i), v[k] = scale * load<f32x8>(outlines.v[k] + i);
        const Box<i32x8> box =
            pixels_within<f32x8>(least_of(least_of(u[0], u[1]), u[2]), least_of(least_of(v[0], v[1]), v[2]),
                                 greatest_of(greatest_of(u[0], u[1]), u[2]),
                                 greatest_of(greatest_of(v[0], v[1]), v[2]), level.width, level.height);
        const f32x8 sum = u[0] + u[1] + u[2];
        const i32x8 unknown = sum != sum;
        const auto missed = [&]() NMBG_INLINE_LAMBDA {
            const i32x8 small = (box.x1 - box.x0 <= 2) & (box.y1 - box.y0 <= 2);
            return small & ~may_cover(u, v, box.x0, box.y0, margin_of(level.width, level.height));
        };
        store_places(box, unknown, missed, level.tiling, i, out);
    }
}

}  // namespace nmbg::NMBG_ISA
