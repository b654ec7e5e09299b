#include "core/rasterize_points.h"

#include <algorithm>
#include <array>

#include "core/bins.h"
#include "core/check.h"
#include "core/draw_discs.h"
#include "core/hiding.h"
#include "core/parallel.h"
#include "core/pyramid.h"
#include "core/runs.h"
#include "core/scatter.h"

namespace nmbg {

template <class T>
void rasterize_points(const PointsView<T>& view, int32_t* index, T* dist2) {
    const Pyramid pyramid(view.height, view.width, view.levels);
    const Hiding hiding(view, pyramid);

    const auto list = [&](int64_t begin, int64_t end, const auto& put) {
        Points<T> points;
        Places places;
        for (int64_t first = begin; first < end; first += Places::most) {
            const int n = static_cast<int>(std::min<int64_t>(Places::most, end - first));
            project(view.h + 3 * first, n, points);
            for (std::size_t k = 0; k < pyramid.levels().size(); ++k) {
                const Level& level = pyramid.levels()[k];
                place(points, n, view.radius, level, hiding.of(k), places);
                list_runs(places, n, first, level, put, [&](int i) {
                    const Run run = Run::one(static_cast<int32_t>(first + i), places.nearest[i]);
                    level.tiling.for_each(places.box(i),
                                          [&](int64_t tile) { put(level.first_tile + tile, run); });
                });
            }
        }
    };
    const Bins<Run> bins(view.points, pyramid.tiles(), view.threads, list);

    parallel_for(pyramid.tiles(), view.threads, [&](int64_t i) {
        const int64_t tile = pyramid.tiles() - 1 - i;  // coarse levels first: their lists are long
        const Level& level = pyramid.of_tile(tile);
        draw_discs(view, level, level.tiling.box(tile - level.first_tile), bins[tile], index, dist2);
    });
}

template <class T>
void rasterize_points_backward(const PointsView<T>& view, const int32_t* index, const T* grad_dist2,
                               T* grad_h) {
    const Pyramid pyramid(view.height, view.width, view.levels);
    for (const Level& level : pyramid.levels()) {
        const auto corners = [&](int64_t pixel, std::array<int32_t, 1>& vertex) {
            vertex[0] = checked("index", index[level.first_pixel + pixel], -1, view.points);
            return vertex[0] >= 0;
        };
        const auto scale = static_cast<T>(level.scale);
        const auto add = [&](int64_t pixel, int, int32_t point) {
            const T* h = view.h + 3 * int64_t{point};
            const T u = h[0] / h[2], v = h[1] / h[2];
            const T px = static_cast<T>(pixel % level.width) + T(0.5);
            const T py = static_cast<T>(pixel / level.width) + T(0.5);
            const T g = 2 * grad_dist2[level.first_pixel + pixel] * scale / h[2];
            const T gx = g * (u * scale - px), gy = g * (v * scale - py);
            T* grad = grad_h + 3 * int64_t{point};
            grad[0] += gx;
            grad[1] += gy;
            grad[2] -= gx * u + gy * v;
        };
        ordered_scatter<1>(int64_t{level.height} * level.width, view.points, view.threads, corners, add);
    }
}

template void rasterize_points(const PointsView<float>&, int32_t*, float*);
template void rasterize_points(const PointsView<double>&, int32_t*, double*);
template void rasterize_points_backward(const PointsView<float>&, const int32_t*, const float*, float*);
template void rasterize_points_backward(const PointsView<double>&, const int32_t*, const double*, double*);

}  // namespace nmbg
