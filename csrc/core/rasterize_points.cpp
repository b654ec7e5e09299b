#include "core/rasterize_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/bins.h"
#include "core/check.h"
#include "core/parallel.h"
#include "core/scatter.h"
#include "core/tiles.h"

namespace nmbg {
namespace {

// A projected point; z > 0 and finite for one that is drawn.
template <class T>
struct Disc {
    T u, v, z;
    int32_t point;
};

template <class T>
bool make_disc(const PointsView<T>& view, int64_t point, Disc<T>& disc) {
    const T x = view.h[3 * point], y = view.h[3 * point + 1], z = view.h[3 * point + 2];
    if (!(z > 0) || !std::isfinite(x) || !std::isfinite(y) || !std::isfinite(z)) return false;
    disc = {x / z, y / z, z, static_cast<int32_t>(point)};
    return true;
}

// Every pixel that a disc may cover.
template <class T>
PixelBox reach(const PointsView<T>& view, const Disc<T>& disc) {
    const double u = disc.u, v = disc.v, r = view.radius;
    return pixels_within(u - r, v - r, u + r, v + r, view.width, view.height);
}

}  // namespace

template <class T>
void rasterize_points(const PointsView<T>& view, int32_t* index, T* dist2) {
    const Tiling tiling(view.height, view.width);
    const T radius2 = static_cast<T>(view.radius * view.radius);

    const auto list = [&](int64_t begin, int64_t end, const auto& put) {
        for (int64_t point = begin; point < end; ++point) {
            Disc<T> disc;
            if (make_disc(view, point, disc))
                tiling.for_each(reach(view, disc), [&](int64_t tile) { put(tile, disc); });
        }
    };
    const Bins<Disc<T>> bins(view.points, tiling.count(), view.threads, list);

    parallel_for(tiling.count(), view.threads, [&](int64_t t) {
        const PixelBox tile = tiling.box(t);
        std::array<T, Tiling::pixels> nearest;
        nearest.fill(std::numeric_limits<T>::infinity());
        for (int32_t y = tile.y0; y < tile.y1; ++y) {
            const int64_t row = int64_t{y} * view.width;
            std::fill(index + row + tile.x0, index + row + tile.x1, -1);
            std::fill(dist2 + row + tile.x0, dist2 + row + tile.x1, T(0));
        }

        for (const Disc<T>& disc : bins[t]) {
            const PixelBox box = reach(view, disc).intersected(tile);
            for (int32_t y = box.y0; y < box.y1; ++y) {
                const T dy = disc.v - (static_cast<T>(y) + T(0.5));
                for (int32_t x = box.x0; x < box.x1; ++x) {
                    const T dx = disc.u - (static_cast<T>(x) + T(0.5));
                    const T d2 = dx * dx + dy * dy;
                    T& depth = nearest[tiling.slot(tile, x, y)];
                    if (!(d2 < radius2 && disc.z < depth)) continue;
                    depth = disc.z;
                    index[int64_t{y} * view.width + x] = disc.point;
                    dist2[int64_t{y} * view.width + x] = d2;
                }
            }
        }
    });
}

template <class T>
void rasterize_points_backward(const PointsView<T>& view, const int32_t* index, const T* grad_dist2,
                               T* grad_h) {
    const int64_t pixels = int64_t{view.height} * view.width;
    const auto corners = [&](int64_t pixel, std::array<int32_t, 1>& vertex) {
        vertex[0] = checked("index", index[pixel], -1, view.points);
        return vertex[0] >= 0;
    };
    ordered_scatter<1>(pixels, view.points, view.threads, corners, [&](int64_t pixel, int, int32_t point) {
        const T* h = view.h + 3 * int64_t{point};
        const T u = h[0] / h[2], v = h[1] / h[2];
        const T px = static_cast<T>(pixel % view.width) + T(0.5);
        const T py = static_cast<T>(pixel / view.width) + T(0.5);
        const T gx = 2 * grad_dist2[pixel] * (u - px) / h[2];
        const T gy = 2 * grad_dist2[pixel] * (v - py) / h[2];
        T* grad = grad_h + 3 * int64_t{point};
        grad[0] += gx;
        grad[1] += gy;
        grad[2] -= gx * u + gy * v;
    });
}

template void rasterize_points(const PointsView<float>&, int32_t*, float*);
template void rasterize_points(const PointsView<double>&, int32_t*, double*);
template void rasterize_points_backward(const PointsView<float>&, const int32_t*, const float*, float*);
template void rasterize_points_backward(const PointsView<double>&, const int32_t*, const double*, double*);

}  // namespace nmbg
