// See find_discs.h. Read once per instruction set (each_isa.h).

namespace nmbg::NMBG_ISA {

// The nearest disc found so far at one pixel.
struct Finder {
    const PointCells& cells;
    float scale, radius2;
    std::size_t level;
    float cx = 0, cy = 0;  // the pixel's centre
    float z = 0;
    int32_t at = -1;  // among the sorted points, -1 for none

    float dist2(int32_t i) const {
        const float dx = cells.u[i] * scale - cx, dy = cells.v[i] * scale - cy;
        return dx * dx + dy * dy;
    }

    bool nearer(float depth, int32_t i) const {
        return depth < z || (depth == z && at >= 0 && cells.point[i] < cells.point[at]);
    }

    // Looks at the points of a cell of level j. Its nearest one stands for all where its disc covers the
    // pixel.
    void visit(std::size_t j, int32_t x, int32_t y) {
        const CellGrid& grid = cells.grid(j);
        const int64_t cell = grid.at(x, y);
        if (grid.z[cell] > z || grid.z[cell] == std::numeric_limits<float>::infinity()) return;
        const int32_t i = grid.nearest[cell];
        if (!nearer(grid.z[cell], i)) return;
        if (dist2(i) < radius2) {
            z = grid.z[cell], at = i;
            return;
        }
        if (grid.inner(x, y, x + 1, y + 1) && beyond(j, x, y)) return;
        if (j == cells.first()) return scan(x, y);
        const CellGrid& fine = cells.grid(j - 1);
        const int32_t m = fine.margin;
        for (int32_t fy = std::max(2 * y, -m); fy < std::min(2 * y + 2, fine.height + m); ++fy)
            for (int32_t fx = std::max(2 * x, -m); fx < std::min(2 * x + 2, fine.width + m); ++fx)
                visit(j - 1, fx, fy);
    }

    // Whether a cell lies outside of the discs that cover the pixel.
    bool beyond(std::size_t j, int32_t x, int32_t y) const {
        const float side = std::ldexp(1.0f, static_cast<int>(j) - static_cast<int>(level));
        const auto away = [&](int32_t i, float c) {
            const float low = static_cast<float>(i) * side;
            return std::max({low - c, c - (low + side), 0.0f});
        };
        const float dx = away(x, cx), dy = away(y, cy);
        return dx * dx + dy * dy > 1.0001f * radius2;
    }

    void scan(int32_t x, int32_t y) {
        const int32_t* list = cells.list(x, y);
        for (int32_t first = list[0]; first < list[1]; first += wide) {
            const f32x8 dx = load<f32x8>(&cells.u[first]) * scale - cx,
                        dy = load<f32x8>(&cells.v[first]) * scale - cy;
            const f32x8 depth = load<f32x8>(&cells.z[first]);
            for (uint32_t near = bits_of((dx * dx + dy * dy < radius2) & (depth <= z)); near;
                 near &= near - 1) {
                const int32_t i = first + std::countr_zero(near);
                if (i < list[1] && nearer(cells.z[i], i)) z = cells.z[i], at = i;
            }
        }
    }
};

// Cells around a pixel that its discs may come from: first those that lie within the radius as a whole.
struct Around {
    struct Offset {
        int32_t x, y;
        float far2;
    };
    std::array<Offset, (2 * PointCells::farthest + 5) * (2 * PointCells::farthest + 5)> at;
    int count = 0, within = 0;

    Around(double radius, int32_t reach) {
        const auto r2 = static_cast<float>(radius * radius);
        for (int32_t y = -reach; y <= reach; ++y)
            for (int32_t x = -reach; x <= reach; ++x) {
                const auto dx = static_cast<float>(std::abs(x)), dy = static_cast<float>(std::abs(y));
                const float nx = std::max(dx - 0.5f, 0.0f), ny = std::max(dy - 0.5f, 0.0f);
                if (nx * nx + ny * ny > 1.0001f * r2) continue;
                const float far2 = (dx + 0.5f) * (dx + 0.5f) + (dy + 0.5f) * (dy + 0.5f);
                at[count++] = {x, y, far2};
                within += far2 < 0.9999f * r2;
            }
        std::sort(at.begin(), at.begin() + count,
                  [](const Offset& a, const Offset& b) { return a.far2 < b.far2; });
    }
};

inline void find_discs(const PointCells& cells, double radius, const Pyramid& pyramid, std::size_t k,
                       const PixelBox& box, int32_t* index, float* dist2) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    const Level& level = pyramid.levels()[k];
    const CellGrid& grid = cells.grid(k);
    const int32_t reach = grid.margin;
    const Around around(radius, reach);
    Finder finder{cells, static_cast<float>(level.scale), static_cast<float>(radius * radius), k};
    for (int32_t y = box.y0; y < box.y1; ++y)
        for (int32_t x = box.x0; x < box.x1; x += wide) {
            // What lies in the margin may stand beyond its cell.
            const bool inner = grid.inner(x - reach, y - reach, x + wide + reach, y + reach + 1);
            int first = inner ? around.within : 0;
            f32x8 z = splat<f32x8>(infinity);
            i32x8 at = splat<i32x8>(-1), tied{};
            for (int i = 0; i < first; ++i) {
                const int64_t cell = grid.at(x + around.at[i].x, y + around.at[i].y);
                const f32x8 depth = load<f32x8>(&grid.z[cell]);
                tied |= (depth == z) & (depth < infinity);
                at = select(depth < z, load<i32x8>(&grid.nearest[cell]), at);
                z = least_of(z, depth);
            }
            // Of equally near points the first counts: looked up one by one.
            if (any_of(tied)) first = 0, z = splat<f32x8>(infinity), at = splat<i32x8>(-1);
            alignas(32) float depths[wide];
            alignas(32) int32_t found[wide];
            store(z, depths), store(at, found);
            finder.cy = static_cast<float>(y) + 0.5f;
            for (int i = first; i < around.count; ++i) {
                const int32_t dx = around.at[i].x, dy = around.at[i].y;
                const f32x8 depth = load<f32x8>(&grid.z[grid.at(x + dx, y + dy)]);
                uint32_t near = bits_of((depth <= load<f32x8>(depths)) & (depth < infinity));
                for (; near; near &= near - 1) {
                    const int lane = std::countr_zero(near);
                    finder.cx = static_cast<float>(x + lane) + 0.5f;
                    finder.z = depths[lane], finder.at = found[lane];
                    finder.visit(k, x + lane + dx, y + dy);
                    depths[lane] = finder.z, found[lane] = finder.at;
                }
            }
            const int n = std::min<int32_t>(wide, box.x1 - x);
            const int64_t pixel = level.first_pixel + int64_t{y} * level.width + x;
            for (int lane = 0; lane < n; ++lane) {
                finder.cx = static_cast<float>(x + lane) + 0.5f;
                index[pixel + lane] = found[lane] < 0 ? -1 : cells.point[found[lane]];
                dist2[pixel + lane] = found[lane] < 0 ? 0 : finder.dist2(found[lane]);
            }
        }
}

}  // namespace nmbg::NMBG_ISA
