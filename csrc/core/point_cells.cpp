#include "core/point_cells.h"

#include <algorithm>
#include <limits>

#include "core/bins.h"
#include "core/draw_discs.h"
#include "core/parallel.h"

namespace nmbg {
namespace {

constexpr float infinity = std::numeric_limits<float>::infinity();

// The cell along one side of a level that holds a coordinate, counted from the rim of the margin.
int32_t cell_of(float x, int32_t size, int32_t margin) {
    const auto low = static_cast<float>(-margin), high = static_cast<float>(size + margin - 1);
    const float bounded = std::clamp(x, low, high);
    const auto towards_zero = static_cast<int32_t>(bounded);
    return towards_zero - (static_cast<float>(towards_zero) > bounded) + margin;
}

}  // namespace

int32_t PointCells::reach(double radius) {
    return static_cast<int32_t>(std::min(std::ceil(radius + 0.5), 2.0 + farthest));
}

PointCells::PointCells(const PointsView<float>& view, const Pyramid& pyramid, std::size_t first)
    : first_(first), margin_(reach(view.radius)) {
    for (std::size_t k = first; k < pyramid.levels().size(); ++k) {
        const Level& level = pyramid.levels()[k];
        // Whole tiles, and room for whole vectors.
        const int64_t columns = ((level.width + 2 * margin_ + 7) >> log_width) + 1;
        const int64_t rows = ((level.height + 2 * margin_ - 1) >> log_height) + 1;
        const int64_t stride = columns << log_width, count = stride * (rows << log_height);
        const Level& finest = pyramid.levels()[first];
        const int halvings = static_cast<int>(k - first);
        grids_.push_back({level.width, level.height, margin_, finest.width >> halvings,
                          finest.height >> halvings, stride, std::make_unique_for_overwrite<float[]>(count),
                          std::make_unique_for_overwrite<int32_t[]>(count)});
    }
    sort(view, pyramid);
    for (std::size_t k = 1; k < grids_.size(); ++k) halve(grids_[k - 1], grids_[k], view.threads);
}

void PointCells::sort(const PointsView<float>& view, const Pyramid& pyramid) {
    CellGrid& grid = grids_[0];
    tile_columns_ = grid.stride >> log_width;
    const int64_t tiles = tile_columns_ * (((grid.height + 2 * margin_ - 1) >> log_height) + 1);
    // Beyond the reach of all levels, in pixels of the first.
    const Level& last = pyramid.levels().back();
    const double scale = pyramid.levels()[first_].scale, up = scale / last.scale, low = -(margin_ + 1) * up;
    const auto shrink = static_cast<float>(scale);
    const auto least = static_cast<float>(low), most_u = static_cast<float>(last.width * up - low),
               most_v = static_cast<float>(last.height * up - low);

    const auto list = [&](int64_t begin, int64_t end, const auto& put) {
        Points<float> points;
        for (int64_t first = begin; first < end; first += Places::most) {
            const int n = static_cast<int>(std::min<int64_t>(Places::most, end - first));
            project(view.h + 3 * first, n, points);
            for (int i = 0; i < n; ++i) {
                const float x = shrink * points.u[i], y = shrink * points.v[i];
                if (!(points.z[i] > 0) | (x < least) | (x > most_u) | (y < least) | (y > most_v)) continue;
                put(tile(cell_of(x, grid.width, margin_), cell_of(y, grid.height, margin_)),
                    static_cast<int32_t>(first + i));
            }
        }
    };
    const Bins<int32_t> bins(view.points, tiles, view.threads, list);

    const int64_t count = bins[tiles - 1].data() + bins[tiles - 1].size() - bins[0].data();
    constexpr int64_t room = 8;
    for (auto* part : {&u, &v, &z}) *part = std::make_unique_for_overwrite<float[]>(count + room);
    for (auto* part : {&u, &v, &z}) std::fill_n(part->get() + count, room, 0.0f);
    point = std::make_unique_for_overwrite<int32_t[]>(count + room);
    begin_ = std::make_unique_for_overwrite<int32_t[]>(tiles * cells + 1);
    begin_[tiles * cells] = static_cast<int32_t>(count);

    parallel_for(tiles, view.threads, [&](int64_t tile) {
        const auto items = bins[tile];
        const auto n = static_cast<int64_t>(items.size());
        const auto first = static_cast<int32_t>(items.data() - bins[0].data());
        int32_t* begin = begin_.get() + tile * cells;
        const int64_t corner =
            (tile / tile_columns_ << log_height) * grid.stride + (tile % tile_columns_ << log_width);
        alignas(64) float depth[cells];
        alignas(64) int32_t nearest[cells], place[cells] = {};
        std::fill_n(depth, cells, infinity);

        const auto own = std::make_unique_for_overwrite<int16_t[]>(n);
        const auto blocks = std::make_unique_for_overwrite<Points<float>[]>(n / Places::most + 1);
        for (int64_t from = 0; from < n; from += Places::most) {
            const int m = static_cast<int>(std::min<int64_t>(Places::most, n - from));
            Points<float>& some = blocks[from / Places::most];
            float h[3 * Places::most];
            for (int i = 0; i < m; ++i) {
                if (from + i + 16 < n) __builtin_prefetch(view.h + 3 * int64_t{items[from + i + 16]});
                std::copy_n(view.h + 3 * int64_t{items[from + i]}, 3, h + 3 * i);
            }
            project(h, m, some);
            for (int i = 0; i < m; ++i) {
                own[from + i] =
                    static_cast<int16_t>(inside(cell_of(shrink * some.u[i], grid.width, margin_),
                                                cell_of(shrink * some.v[i], grid.height, margin_)));
                ++place[own[from + i]];
            }
        }
        int32_t next = first;
        for (int cell = 0; cell < cells; ++cell) {
            const int32_t in_cell = place[cell];
            begin[cell] = place[cell] = next;
            next += in_cell;
        }
        // In ascending order: the first of equally near points stays.
        for (int64_t i = 0; i < n; ++i) {
            const Points<float>& some = blocks[i / Places::most];
            const int64_t k = i % Places::most;
            const int32_t at = place[own[i]]++;
            u[at] = some.u[k], v[at] = some.v[k], z[at] = some.z[k], point[at] = items[i];
            if (some.z[k] < depth[own[i]]) depth[own[i]] = some.z[k], nearest[own[i]] = at;
        }
        for (int row = 0; row < 1 << log_height; ++row) {
            std::copy_n(depth + (row << log_width), 1 << log_width,
                        grid.z.get() + corner + row * grid.stride);
            std::copy_n(nearest + (row << log_width), 1 << log_width,
                        grid.nearest.get() + corner + row * grid.stride);
        }
    });
}

void PointCells::halve(const CellGrid& fine, CellGrid& coarse, int threads) const {
    const int32_t m = margin_;
    parallel_for(coarse.height + 2 * m, threads, [&](int64_t row) {
        const int32_t y = static_cast<int32_t>(row) - m;
        float* to = coarse.z.get() + row * coarse.stride;
        std::fill_n(to, coarse.stride, infinity);
        for (int32_t x = -m; x < coarse.width + m; ++x, ++to)
            for (int32_t fy = std::max(2 * y, -m); fy < std::min(2 * y + 2, fine.height + m); ++fy)
                for (int32_t fx = std::max(2 * x, -m); fx < std::min(2 * x + 2, fine.width + m); ++fx) {
                    const int64_t from = fine.at(fx, fy), here = to - coarse.z.get();
                    if (fine.z[from] > *to || fine.z[from] == infinity) continue;
                    if (fine.z[from] == *to && point[fine.nearest[from]] > point[coarse.nearest[here]])
                        continue;
                    *to = fine.z[from], coarse.nearest[here] = fine.nearest[from];
                }
    });
}

}  // namespace nmbg
