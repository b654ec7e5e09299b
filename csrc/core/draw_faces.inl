// See draw_faces.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

NMBG_INLINE f64x8 load_doubles(const float* from) {
    return __builtin_convertvector(load<f32x8>(from), f64x8);
}
NMBG_INLINE f64x8 load_doubles(const double* from) { return load<f64x8>(from); }
NMBG_INLINE void store_doubles(const f64x8& x, float* to) { store(__builtin_convertvector(x, f32x8), to); }
NMBG_INLINE void store_doubles(const f64x8& x, double* to) { store(x, to); }

constexpr int small_side = 4;

// Eight faces: their edges, and the pixels of the tile that they may reach.
struct Batch {
    Triangle<f64x8> t;
    Box<i32x8> reach;
    i32x8 small;    // whether at most 4 × 4 pixels are in reach
    i32x8 covered;  // then, a bit for each of them that is inside

    double edge(int i, int k, double x, double y) const {
        return t.a[k][i] * x + (t.b[k][i] * y + t.c[k][i]);
    }
};

template <class T>
NMBG_INLINE Batch prepare(const FacesView<T>& view, const Level& level, const PixelBox& tile,
                          const int32_t* faces) {
    T corner[9][wide];
    for (int i = 0; i < wide; ++i) {
        const int32_t* vertices = view.faces + 3 * int64_t{faces[i]};
        for (int k = 0; k < 3; ++k) {
            const T* h = view.h + 3 * int64_t{vertices[k]};
            for (int d = 0; d < 3; ++d) corner[3 * k + d][i] = h[d];
        }
    }
    Corners<f64x8> h;
    for (int k = 0; k < 3; ++k)
        h.at[k] = {load_doubles(corner[3 * k]) * level.scale, load_doubles(corner[3 * k + 1]) * level.scale,
                   load_doubles(corner[3 * k + 2])};
    Batch batch{Triangle<f64x8>(h), {}, {}, {}};

    f32x8 u[3], v[3];
    i64x8 front = h[0].z > 0;
    front &= (h[1].z > 0) & (h[2].z > 0);
    for (int k = 0; k < 3; ++k) {
        const f32x8 inverse = 1 / __builtin_convertvector(h[k].z, f32x8);
        u[k] = __builtin_convertvector(h[k].x, f32x8) * inverse;
        v[k] = __builtin_convertvector(h[k].y, f32x8) * inverse;
    }
    const Box<i32x8> near = pixels_within<f32x8>(
        least_of(least_of(u[0], u[1]), u[2]), least_of(least_of(v[0], v[1]), v[2]),
        greatest_of(greatest_of(u[0], u[1]), u[2]), greatest_of(greatest_of(v[0], v[1]), v[2]), level.width,
        level.height);
    // What crosses the camera plane may reach the whole tile.
    const i32x8 bounded = narrower(front);
    const i32x8 x0 = i32x8{} + tile.x0, y0 = i32x8{} + tile.y0, x1 = i32x8{} + tile.x1, y1 = i32x8{} + tile.y1;
    Box<i32x8>& reach = batch.reach;
    reach = {select(bounded & (near.x0 > x0), near.x0, x0), select(bounded & (near.y0 > y0), near.y0, y0),
             select(bounded & (near.x1 < x1), near.x1, x1), select(bounded & (near.y1 < y1), near.y1, y1)};
    const i32x8 drawn = narrower(batch.t.drawable());
    reach.x1 = select(drawn, reach.x1, reach.x0);
    const i32x8 across = reach.x1 - reach.x0, down = reach.y1 - reach.y0;
    batch.small = (across <= small_side) & (down <= small_side);
    const int rows = greatest_in(batch.small & down), columns = greatest_in(batch.small & across);
    const Triangle<f64x8>& t = batch.t;
    const f64x8 x0_centre = number<f64x8>(reach.x0) + 0.5, y0_centre = number<f64x8>(reach.y0) + 0.5;
    for (int row = 0; row < rows; ++row) {
        const f64x8 y = y0_centre + row;
        const f64x8 row0 = t.b[0] * y + t.c[0], row1 = t.b[1] * y + t.c[1], row2 = t.b[2] * y + t.c[2];
        for (int column = 0; column < columns; ++column) {
            const f64x8 x = x0_centre + column;
            const i64x8 inside = (t.a[0] * x + row0 >= t.least[0]) & (t.a[1] * x + row1 >= t.least[1]) &
                                 (t.a[2] * x + row2 >= t.least[2]);
            batch.covered |= narrower(inside) & (column < across) & (row < down) &
                             (1 << (small_side * row + column));
        }
    }
    return batch;
}

// Lets the pixels of face i that are known to be inside compete.
NMBG_INLINE void draw_small(const Batch& batch, int i, int32_t face, const PixelBox& box, int stride,
                            FaceTile& tile) {
    for (auto covered = static_cast<uint32_t>(batch.covered[i]); covered; covered &= covered - 1) {
        const int pixel = std::countr_zero(covered);
        const int32_t column = batch.reach.x0[i] + pixel % small_side,
                      row = batch.reach.y0[i] + pixel / small_side;
        const double x = column + 0.5, y = row + 0.5;
        const double e0 = batch.edge(i, 0, x, y), e1 = batch.edge(i, 1, x, y), e2 = batch.edge(i, 2, x, y);
        const double depth = batch.t.determinant[i] / (e0 + e1 + e2);
        const int slot = (row - box.y0) * stride + (column - box.x0);
        if (!(depth < tile.depth[slot])) continue;
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
            const i64x8 wins = inside & (depth < nearest);
            store(select(wins, depth, nearest), &tile.depth[at]);
            store(select(wins, e0, load<f64x8>(&tile.e0[at])), &tile.e0[at]);
            store(select(wins, e1, load<f64x8>(&tile.e1[at])), &tile.e1[at]);
            store(select(wins, e2, load<f64x8>(&tile.e2[at])), &tile.e2[at]);
            const i32x8 before = load<i32x8>(&tile.face[at]);
            store(select(narrower(wins), i32x8{} + face, before), &tile.face[at]);
        }
    }
}

template <class T>
NMBG_INLINE void draw_any(const FacesView<T>& view, const Level& level, const PixelBox& box,
                          std::span<const int32_t> faces, const FacesResult<T>& out) {
    FaceTile tile;
    tile.depth.fill(std::numeric_limits<double>::infinity());
    tile.e0.fill(0), tile.e1.fill(0), tile.e2.fill(0), tile.face.fill(-1);
    const int stride = level.tiling.stride();

    for (std::size_t begin = 0; begin < faces.size(); begin += wide) {
        const int n = static_cast<int>(std::min<std::size_t>(wide, faces.size() - begin));
        int32_t some[wide];
        for (int i = 0; i < wide; ++i) some[i] = faces[begin + std::min(i, n - 1)];
        const Batch batch = prepare(view, level, box, some);
        for (int i = 0; i < n; ++i) {
            if (batch.small[i])
                draw_small(batch, i, some[i], box, stride, tile);
            else
                draw_rows(batch, i, some[i], box, stride, tile);
        }
    }

    for (int32_t row = box.y0; row < box.y1; ++row) {
        const int64_t pixel = level.first_pixel + int64_t{row} * level.width + box.x0;
        for (int column = 0; column < box.x1 - box.x0; column += wide) {
            const int at = (row - box.y0) * stride + column;
            const f64x8 e0 = load<f64x8>(&tile.e0[at]), e1 = load<f64x8>(&tile.e1[at]),
                        e2 = load<f64x8>(&tile.e2[at]), z = load<f64x8>(&tile.depth[at]);
            const i64x8 seen = z <= std::numeric_limits<double>::max();
            const f64x8 inverse = 1 / select(seen, e0 + e1 + e2, splat<f64x8>(1));
            T b0[wide], b1[wide], b2[wide], depth[wide], bary[3 * wide];
            store_doubles(e0 * inverse, b0), store_doubles(e1 * inverse, b1), store_doubles(e2 * inverse, b2);
            store_doubles(select(seen, z, splat<f64x8>(0)), depth);
            store_interleaved(b0, b1, b2, bary);
            const int n = std::min(wide, box.x1 - box.x0 - column);
            std::copy_n(&tile.face[at], n, out.face + pixel + column);
            std::copy_n(depth, n, out.depth + pixel + column);
            std::copy_n(bary, 3 * n, out.bary + 3 * (pixel + column));
        }
    }
}

inline void draw_faces(const FacesView<float>& view, const Level& level, const PixelBox& box,
                       std::span<const int32_t> faces, const FacesResult<float>& out) {
    draw_any(view, level, box, faces, out);
}

}  // namespace nmbg::NMBG_ISA
