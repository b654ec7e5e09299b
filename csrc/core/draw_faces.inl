// See draw_faces.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

// Eight faces: their edges, and the pixels of the tile that they may reach.
struct Batch {
    Triangle<f64x8> t;
    Box<i32x8> reach;
    i32x8 small;  // whether at most 4 × 4 pixels are in reach
    i32x8 near;   // then, a bit for each of them that is inside, or is not but by rounding

    // A bit for each face that may own a pixel.
    NMBG_INLINE uint32_t lanes() const {
        return bits_of(select(small, near != 0, (reach.x0 < reach.x1) & (reach.y0 < reach.y1)));
    }

    NMBG_INLINE double edge(int i, int k, double x, double y) const {
        return t.a[k][i] * x + (t.b[k][i] * y + t.c[k][i]);
    }
};

// Which of the 4 × 4 pixels in reach are inside, in float: what is left out is outside for certain.
NMBG_INLINE i32x8 near_small(const Batch& batch) {
    const Box<i32x8>& reach = batch.reach;
    const i32x8 zero{}, across = select(batch.small, greatest_of(reach.x1 - reach.x0, zero), zero),
                        down = select(batch.small, greatest_of(reach.y1 - reach.y0, zero), zero);
    const f64x8 x = number<f64x8>(reach.x0) + 0.5, y = number<f64x8>(reach.y0) + 0.5;
    f32x8 a[3], b[3], e[3];
    for (int k = 0; k < 3; ++k) {
        a[k] = __builtin_convertvector(batch.t.a[k], f32x8),
        b[k] = __builtin_convertvector(batch.t.b[k], f32x8);
        e[k] = __builtin_convertvector(batch.t.edge(k, x, y), f32x8);
        // More than four roundings of what is summed below.
        const f32x8 size =
            greatest_of(e[k], -e[k]) + 4 * (greatest_of(a[k], -a[k]) + greatest_of(b[k], -b[k]));
        e[k] += 1e-6f * size;
    }
    i32x8 near{};
    const int rows = greatest_in(down), columns = greatest_in(across);
    for (int row = 0; row < rows; ++row) {
        f32x8 e0 = e[0], e1 = e[1], e2 = e[2];
        for (int column = 0; column < columns; ++column) {
            near |= ~(least_of(least_of(e0, e1), e2) < 0) & (1 << (4 * row + column));
            e0 += a[0], e1 += a[1], e2 += a[2];
        }
        for (int k = 0; k < 3; ++k) e[k] += b[k];
    }
    const i32x8 one = zero + 1;
    return near & (((one << across) - 1) * 0x1111) & ((one << (4 * down)) - 1);
}

template <class T>
NMBG_INLINE Batch prepare(const FacesView<T>& view, const Level& level, const PixelBox& tile,
                          const int32_t* faces) {
    int32_t vertices[3 * wide];
    for (int i = 0; i < wide; ++i) std::copy_n(view.faces + 3 * int64_t{faces[i]}, 3, vertices + 3 * i);
    Corners<f64x8> h;
    for (int k = 0; k < 3; ++k) {
        const Vec3<eight<T>> at = load_corners(view.h, vertices + k);
        h.at[k] = {doubles(at.x) * level.scale, doubles(at.y) * level.scale, doubles(at.z)};
    }
    Batch batch{Triangle<f64x8>(h), {}, {}, {}};

    f32x8 u[3], v[3];
    // What is nearer has no reciprocal in float.
    constexpr double nearest = 1e-30;
    const i64x8 front = (h[0].z > nearest) & (h[1].z > nearest) & (h[2].z > nearest);
    for (int k = 0; k < 3; ++k) {
        const f32x8 inverse = 1 / __builtin_convertvector(h[k].z, f32x8);
        u[k] = __builtin_convertvector(h[k].x, f32x8) * inverse;
        v[k] = __builtin_convertvector(h[k].y, f32x8) * inverse;
    }
    const Box<i32x8> near = pixels_within<f32x8>(least_of(u), least_of(v), greatest_of(u), greatest_of(v),
                                                 level.width, level.height);
    // What crosses the camera plane, or nearly does, may reach the whole tile.
    const i32x8 bounded = narrow(front);
    const i32x8 left = i32x8{} + tile.x0, top = i32x8{} + tile.y0;
    const i32x8 right = i32x8{} + tile.x1, bottom = i32x8{} + tile.y1;
    Box<i32x8>& reach = batch.reach;
    reach = {select(bounded & (near.x0 > left), near.x0, left),
             select(bounded & (near.y0 > top), near.y0, top),
             select(bounded & (near.x1 < right), near.x1, right),
             select(bounded & (near.y1 < bottom), near.y1, bottom)};
    const i32x8 drawn = narrow(batch.t.drawable());
    reach.x1 = select(drawn, reach.x1, reach.x0);
    batch.small = (reach.x1 - reach.x0 <= 4) & (reach.y1 - reach.y0 <= 4);
    batch.near = near_small(batch);
    return batch;
}

// Tests the pixels of face i that are near.
NMBG_INLINE void draw_small(const Batch& batch, int i, int32_t face, const PixelBox& box, int stride,
                            FaceTile& tile) {
    const Triangle<f64x8>& t = batch.t;
    for (auto near = static_cast<uint32_t>(batch.near[i]); near; near &= near - 1) {
        const int pixel = std::countr_zero(near);
        const int32_t column = batch.reach.x0[i] + pixel % 4, row = batch.reach.y0[i] + pixel / 4;
        const double x = column + 0.5, y = row + 0.5;
        const double e0 = batch.edge(i, 0, x, y), e1 = batch.edge(i, 1, x, y), e2 = batch.edge(i, 2, x, y);
        const double depth = t.determinant[i] / (e0 + e1 + e2);
        const int slot = (row - box.y0) * stride + (column - box.x0);
        const bool inside = (e0 >= t.least[0][i]) & (e1 >= t.least[1][i]) & (e2 >= t.least[2][i]);
        const double nearest = tile.depth[slot];
        if (!(inside & ((depth < nearest) | ((depth == nearest) & (face < tile.face[slot]))))) continue;
        tile.depth[slot] = depth, tile.face[slot] = face;
        tile.e0[slot] = e0, tile.e1[slot] = e1, tile.e2[slot] = e2;
    }
}

// Tests groups of pixels, whole ones: what lies beyond the face's reach is not inside.
NMBG_INLINE void draw_rows(const Batch& batch, int i, int32_t face, const PixelBox& box, int stride,
                           FaceTile& tile) {
    const Triangle<f64x8>& t = batch.t;
    const double a0 = t.a[0][i], a1 = t.a[1][i], a2 = t.a[2][i];
    const double b0 = t.b[0][i], b1 = t.b[1][i], b2 = t.b[2][i];
    const double c0 = t.c[0][i], c1 = t.c[1][i], c2 = t.c[2][i];
    const double least0 = t.least[0][i], least1 = t.least[1][i], least2 = t.least[2][i];
    const double determinant = t.determinant[i];
    const int first = (batch.reach.x0[i] - box.x0) / wide * wide, end = batch.reach.x1[i] - box.x0;
    for (int32_t row = batch.reach.y0[i]; row < batch.reach.y1[i]; ++row) {
        const double y = row + 0.5;
        const double row0 = b0 * y + c0, row1 = b1 * y + c1, row2 = b2 * y + c2;
        for (int column = first; column < end; column += wide) {
            const f64x8 x = f64x8{0, 1, 2, 3, 4, 5, 6, 7} + (box.x0 + column + 0.5);
            const f64x8 e0 = a0 * x + row0, e1 = a1 * x + row1, e2 = a2 * x + row2;
            const i64x8 inside = (e0 >= least0) & (e1 >= least1) & (e2 >= least2);
            if (!any_of(inside)) continue;
            const int at = (row - box.y0) * stride + column;
            const f64x8 nearest = load<f64x8>(&tile.depth[at]), depth = determinant / (e0 + e1 + e2);
            const i32x8 before = load<i32x8>(&tile.face[at]);
            const i64x8 wins =
                inside & ((depth < nearest) | ((depth == nearest) & mask_for<f64x8>(before > face)));
            store(select(wins, depth, nearest), &tile.depth[at]);
            store(select(wins, e0, load<f64x8>(&tile.e0[at])), &tile.e0[at]);
            store(select(wins, e1, load<f64x8>(&tile.e1[at])), &tile.e1[at]);
            store(select(wins, e2, load<f64x8>(&tile.e2[at])), &tile.e2[at]);
            store(select(narrow(wins), i32x8{} + face, before), &tile.face[at]);
        }
    }
}

template <class T>
NMBG_INLINE void draw_any(const FacesView<T>& view, const Level& level, const PixelBox& box,
                          std::span<Run> runs, const FacesResult<T>& out) {
    if (runs.empty()) {
        for (int32_t row = box.y0; row < box.y1; ++row) {
            const int64_t pixel = level.first_pixel + int64_t{row} * level.width + box.x0;
            const int n = box.x1 - box.x0;
            std::fill_n(out.face + pixel, n, -1);
            std::fill_n(out.depth + pixel, n, T(0));
            std::fill_n(out.bary + 3 * pixel, 3 * n, T(0));
        }
        return;
    }

    FaceTile tile;
    const int stride = level.tiling.stride();
    clear(tile.depth, box, stride), tile.face.fill(-1);
    tile.e0.fill(0), tile.e1.fill(0), tile.e2.fill(0);

    const auto ask = [&](int32_t face)
                         NMBG_INLINE_LAMBDA { __builtin_prefetch(view.faces + 3 * int64_t{face}); };
    const auto fetch = [&](const int32_t* faces) NMBG_INLINE_LAMBDA {
        for (int i = 0; i < wide; ++i)
            for (int k = 0; k < 3; ++k)
                __builtin_prefetch(view.h + 3 * int64_t{view.faces[3 * int64_t{faces[i]} + k]});
    };
    const auto draw = [&](const int32_t* faces) NMBG_INLINE_LAMBDA {
        const Batch batch = prepare(view, level, box, faces);
        for (uint32_t some = batch.lanes(); some; some &= some - 1) {
            const int i = std::countr_zero(some);
            if (batch.small[i])
                draw_small(batch, i, faces[i], box, stride, tile);
            else
                draw_rows(batch, i, faces[i], box, stride, tile);
        }
    };
    front_to_back(
        runs, [&]() NMBG_INLINE_LAMBDA { return greatest_of_all<f64x8>(tile.depth); }, ask, fetch, draw);

    for (int32_t row = box.y0; row < box.y1; ++row) {
        const int64_t pixel = level.first_pixel + int64_t{row} * level.width + box.x0;
        for (int column = 0; column < box.x1 - box.x0; column += wide) {
            const int at = (row - box.y0) * stride + column;
            const f64x8 e0 = load<f64x8>(&tile.e0[at]), e1 = load<f64x8>(&tile.e1[at]),
                        e2 = load<f64x8>(&tile.e2[at]), z = load<f64x8>(&tile.depth[at]);
            const i64x8 seen = z <= std::numeric_limits<double>::max();
            const f64x8 inverse = 1 / select(seen, e0 + e1 + e2, splat<f64x8>(1));
            const auto b0 = __builtin_convertvector(e0 * inverse, eight<T>);
            const auto b1 = __builtin_convertvector(e1 * inverse, eight<T>);
            const auto b2 = __builtin_convertvector(e2 * inverse, eight<T>);
            const auto depth = __builtin_convertvector(select(seen, z, splat<f64x8>(0)), eight<T>);
            const int n = box.x1 - box.x0 - column;
            if (n >= wide) {
                store(load<i32x8>(&tile.face[at]), out.face + pixel + column);
                store(depth, out.depth + pixel + column);
                store_interleaved(b0, b1, b2, out.bary + 3 * (pixel + column));
            } else {
                T bary[3 * wide];
                store_interleaved(b0, b1, b2, bary);
                for (int i = 0; i < n; ++i) {
                    out.face[pixel + column + i] = tile.face[at + i];
                    out.depth[pixel + column + i] = depth[i];
                }
                std::copy_n(bary, 3 * n, out.bary + 3 * (pixel + column));
            }
        }
    }
}

inline void draw_faces(const FacesView<float>& view, const Level& level, const PixelBox& box,
                       std::span<Run> runs, const FacesResult<float>& out) {
    draw_any(view, level, box, runs, out);
}

}  // namespace nmbg::NMBG_ISA
