#include "core/hiding.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/draw_discs.h"
#include "core/parallel.h"
#include "core/portable.h"

namespace nmbg {
namespace {

constexpr float infinity = std::numeric_limits<float>::infinity();

struct Offset {
    int32_t dx, dy;
};

// The nearest (or farthest) distance of a cell, [x, x + 1] × [y, y + 1], from the origin.
double nearest(double x, double y) {
    return std::hypot(std::max({x, -x - 1, 0.0}), std::max({y, -y - 1, 0.0}));
}
double farthest(double x, double y) { return std::hypot(std::max(-x, x + 1), std::max(-y, y + 1)); }

// to[i] ← least or greatest of itself and from[i], strides apart.
NMBG_WIDEST void keep_least(float* to, const float* from, int32_t n, int32_t stride) {
    if (stride == 1)
        for (int32_t i = 0; i < n; ++i) to[i] = std::min(to[i], from[i]);
    else
        for (int32_t i = 0; i < n; ++i) to[i] = std::min(to[i], from[int64_t{i} * stride]);
}
NMBG_WIDEST void keep_greatest(float* to, const float* from, int32_t n, int32_t stride) {
    if (stride == 1)
        for (int32_t i = 0; i < n; ++i) to[i] = std::max(to[i], from[i]);
    else
        for (int32_t i = 0; i < n; ++i) to[int64_t{i} * stride] = std::max(to[int64_t{i} * stride], from[i]);
}

// The nearest z of each four cells, in a cell of the next level.
void halve(const Cells& fine, Cells& coarse) {
    for (int32_t y = 0; y < fine.height; ++y)
        for (int32_t x = 0; x < fine.width; ++x) {
            float& z = coarse.z[int64_t{y / 2} * coarse.width + x / 2];
            z = std::min(z, fine.z[int64_t{y} * fine.width + x]);
        }
}

// Nearest z per cell → the z beyond which a point of the cell wins no pixel.
void spread(Cells& cells, int cut, double radius, const Level& level, int threads) {
    const int32_t side = 1 << cut;
    const double half = side / 2.0, margin = portable::margin_of(level.width, level.height);
    const int32_t reach = static_cast<int32_t>(std::ceil(radius)) + 1;

    // Per pixel, the nearest z of the cells whose points cover it for certain.
    std::vector<Offset> covering;
    for (int32_t dy = -reach * side; dy <= reach * side; ++dy)
        for (int32_t dx = -reach * side; dx <= reach * side; ++dx)
            if (farthest(dx - half, dy - half) <= (radius - margin) * side) covering.push_back({dx, dy});
    std::vector<float> bound(int64_t{level.height} * level.width, infinity);
    parallel_for(level.height, threads, [&](int64_t y) {
        for (const auto [dx, dy] : covering) {
            const int64_t row = y * side + dy;
            if (row < 0 || row >= cells.height) continue;
            const int32_t x0 = dx < 0 ? (-dx + side - 1) >> cut : 0;
            const int32_t x1 = std::min(level.width, (cells.width - 1 - dx + side) >> cut);
            if (x0 < x1)
                keep_least(bound.data() + y * level.width + x0,
                           cells.z.data() + row * cells.width + x0 * side + dx, x1 - x0, side);
        }
    });

    // Per cell, the farthest of the pixels that its points may cover.
    std::vector<std::vector<Offset>> covered(side * side);
    for (int32_t phase = 0; phase < side * side; ++phase)
        for (int32_t dy = -reach; dy <= reach; ++dy)
            for (int32_t dx = -reach; dx <= reach; ++dx)
                if (nearest(phase % side - half - dx * side, phase / side - half - dy * side) <=
                    (radius + margin) * side)
                    covered[phase].push_back({dx, dy});
    std::fill(cells.z.begin(), cells.z.end(), -infinity);
    parallel_for(level.height, threads, [&](int64_t y) {
        for (int32_t phase = 0; phase < side * side; ++phase)
            for (const auto [dx, dy] : covered[phase]) {
                if (y + dy < 0 || y + dy >= level.height) continue;
                const int32_t x0 = std::max(0, -dx), x1 = std::min(level.width, level.width - dx);
                if (x0 < x1)
                    keep_greatest(
                        cells.z.data() + (y * side + phase / side) * cells.width + x0 * side + phase % side,
                        bound.data() + (y + dy) * level.width + x0 + dx, x1 - x0, side);
            }
    });
}

}  // namespace

template <class T>
Hiding::Hiding(const PointsView<T>& view, const Pyramid& pyramid) {
    // Cells of a third to a sixth of the radius; and where these would not be few or not fit, none.
    if (view.radius < 0.375 || view.radius > 8) return;
    const int cut = std::max(0, static_cast<int>(std::ceil(std::log2(3 / view.radius))));
    const std::vector<Level>& levels = pyramid.levels();
    first_ = 1;
    while (first_ < levels.size() && view.points < 2 * int64_t{levels[first_].height} * levels[first_].width)
        ++first_;

    for (std::size_t k = first_; k < levels.size(); ++k) {
        const int32_t height = levels[k].height << cut, width = levels[k].width << cut;
        levels_.push_back({height, width, static_cast<float>(std::ldexp(levels[k].scale, cut)),
                           std::vector<float>(int64_t{height} * width, infinity)});
        Cells& cells = levels_.back();
        if (k > first_)
            halve(levels_[k - first_ - 1], cells);
        else
            parallel_blocks(view.points, view.threads, [&](int64_t begin, int64_t end) {
                Points<T> points;
                for (int64_t i = begin; i < end; i += Places::most) {
                    const int n = static_cast<int>(std::min<int64_t>(Places::most, end - i));
                    project(view.h + 3 * i, n, points);
                    keep_nearest(points, n, cells);
                }
            });
    }
    for (std::size_t k = first_; k < levels.size(); ++k)
        spread(levels_[k - first_], cut, view.radius, levels[k], view.threads);
}

template Hiding::Hiding(const PointsView<float>&, const Pyramid&);
template Hiding::Hiding(const PointsView<double>&, const Pyramid&);

}  // namespace nmbg
