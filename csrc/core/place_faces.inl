// See place_faces.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

// Depths are determinant / Σ edges in double: as near as the nearest corner but for rounding, which matters
// where a face is seen from its edge. The relative error is about 2⁻⁵³ u v / area, times 16 at most for the
// ratio of the corners' depths; what may come to more than 10⁻⁴, or is not known for the rounding of u and v
// in float, has no bound.
NMBG_INLINE f32x8 nearest_of(const f32x8* u, const f32x8* v, const f32x8* z) {
    const auto size = [](const f32x8& x) NMBG_INLINE_LAMBDA { return greatest_of(x, -x); };
    const f32x8 u0 = least_of(u), u1 = greatest_of(u), v0 = least_of(v), v1 = greatest_of(v),
                z0 = least_of(z);
    const f32x8 across = greatest_of(size(u0), size(u1)), down = greatest_of(size(v0), size(v1));
    const f32x8 area = size((u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0]));
    const f32x8 doubt = 0x1p-20f * (across + down) * (u1 - u0 + v1 - v0) + 0x1p-32f * across * down;
    const i32x8 known = (area > doubt) & (greatest_of(z) < 16 * z0);
    return select(known, z0 * (1 - 1e-4f), splat<f32x8>(-std::numeric_limits<double>::infinity()));
}

// Writes whole vectors: beyond n, the last face again.
template <class T>
NMBG_INLINE bool outline_any(const T* h, int64_t vertices, const int32_t* faces, int n, Outlines& out) {
    constexpr T nowhere = std::numeric_limits<T>::quiet_NaN();
    const eight<T> most = splat<eight<T>>(std::numeric_limits<T>::max());
    const auto last = static_cast<int32_t>(vertices - 1);
    int32_t rest[3 * wide];
    for (int first = 0; first < n; first += wide) {
        const int32_t* eight_faces = faces + 3 * first;
        if (first + wide > n) {
            for (int i = 0; i < 3 * wide; ++i)
                rest[i] = eight_faces[std::min(i / 3, n - 1 - first) * 3 + i % 3];
            eight_faces = rest;
        }
        i32x8 wrong{};
        for (int k = 0; k < 3; ++k) {
            const i32x8 vertex = load<i32x8>(eight_faces + wide * k);
            wrong |= (vertex < 0) | (vertex > last);
        }
        if (any_of(wrong)) return false;
        f32x8 u[3], v[3];
        for (int k = 0; k < 3; ++k) {
            const Vec3<eight<T>> at = load_corners(h, eight_faces + k);
            const auto drawn = (at.z > 0) & (at.z <= most) & (greatest_of(at.x, -at.x) <= most) &
                               (greatest_of(at.y, -at.y) <= most);
            const eight<T> inverse = 1 / select(drawn, at.z, splat<eight<T>>(nowhere));
            u[k] = floats(at.x * inverse), v[k] = floats(at.y * inverse);
            store(u[k], out.u[k] + first), store(v[k], out.v[k] + first);
            store(floats(at.z), out.z[k] + first);
        }
        const f32x8 sum = u[0] + u[1] + u[2];
        store(select(sum == sum, least_of(u), sum), out.u0 + first), store(greatest_of(u), out.u1 + first);
        store(least_of(v), out.v0 + first), store(greatest_of(v), out.v1 + first);
    }
    return true;
}

inline bool outline(const float* h, int64_t vertices, const int32_t* faces, int n, Outlines& out) {
    return outline_any(h, vertices, faces, n, out);
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
    const float margin = margin_of(level.width, level.height);
    for (int i = 0; i < n; i += wide) {
        const f32x8 u0 = scale * load<f32x8>(outlines.u0 + i), u1 = scale * load<f32x8>(outlines.u1 + i);
        const f32x8 v0 = scale * load<f32x8>(outlines.v0 + i), v1 = scale * load<f32x8>(outlines.v1 + i);
        const Box<i32x8> box = pixels_within<f32x8>(u0, v0, u1, v1, level.width, level.height);
        const i32x8 unknown = u0 != u0;
        f32x8 u[3], v[3];
        const auto missed = [&]() NMBG_INLINE_LAMBDA {
            for (int k = 0; k < 3; ++k)
                u[k] = scale * load<f32x8>(outlines.u[k] + i), v[k] = scale * load<f32x8>(outlines.v[k] + i);
            const i32x8 small = (box.x1 - box.x0 <= 2) & (box.y1 - box.y0 <= 2);
            return small & ~may_cover(u, v, box.x0, box.y0, margin);
        };
        const auto nearest = [&]() NMBG_INLINE_LAMBDA {
            f32x8 z[3];
            for (int k = 0; k < 3; ++k) z[k] = load<f32x8>(outlines.z[k] + i);
            return nearest_of(u, v, z);
        };
        store_places(box, unknown, missed, nearest, level.tiling, i, out);
    }
}

}  // namespace nmbg::NMBG_ISA
