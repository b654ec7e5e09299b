#include "core/rasterize_faces.h"

#include <algorithm>

#include "core/bins.h"
#include "core/check.h"
#include "core/draw_faces.h"
#include "core/parallel.h"
#include "core/place_faces.h"
#include "core/pyramid.h"
#include "core/runs.h"
#include "core/triangle.h"

namespace nmbg {
namespace {

// Puts a face into each tile that it may touch.
template <class T, class Put>
void spread(const FacesView<T>& view, const Level& level, int64_t face, float nearest, PixelBox box,
            bool in_front, const Put& put) {
    constexpr int64_t few = 4;
    const auto item = Run::one(static_cast<int32_t>(face), nearest);
    if (in_front && level.tiling.touched(box) <= few) {
        level.tiling.for_each(box, [&](int64_t tile) { put(level.first_tile + tile, item); });
        return;
    }
    // Large faces are tested against each tile: a box alone would list them in many that they do not touch.
    const Corners<double> corners = corners_of(view, level.scale, face);
    if (!in_front) box = reach(corners, level.width, level.height);
    const Triangle<double> triangle(corners);
    level.tiling.for_each(box, [&](int64_t tile) {
        if (may_cover(triangle, level.tiling.box(tile).intersected(box))) put(level.first_tile + tile, item);
    });
}

}  // namespace

template <class T>
void rasterize_faces(const FacesView<T>& view, const FacesResult<T>& out) {
    const Pyramid pyramid(view.height, view.width, view.levels);
    if (view.count && !view.vertices) checked("faces", view.faces[0], 0, 0);

    const auto list = [&](int64_t begin, int64_t end, const auto& put) {
        Outlines outlines;
        Places places;
        for (int64_t first = begin; first < end; first += Places::most) {
            const int n = static_cast<int>(std::min<int64_t>(Places::most, end - first));
            const int32_t* faces = view.faces + 3 * first;
            if (!outline(view.h, view.vertices, faces, n, outlines))
                for (int i = 0; i < 3 * n; ++i) checked("faces", faces[i], 0, view.vertices);
            for (const Level& level : pyramid.levels()) {
                place(outlines, n, level, places);
                list_runs(places, n, first, level, put, [&](int i) {
                    spread(view, level, first + i, places.nearest[i], places.box(i), outlines.in_front(i),
                           put);
                });
            }
        }
    };
    const Bins<Run> bins(view.count, pyramid.tiles(), view.threads, list);

    parallel_for(pyramid.tiles(), view.threads, [&](int64_t tile) {
        const Level& level = pyramid.of_tile(tile);
        draw_faces(view, level, level.tiling.box(tile - level.first_tile), bins[tile], out);
    });
}

template void rasterize_faces(const FacesView<float>&, const FacesResult<float>&);
template void rasterize_faces(const FacesView<double>&, const FacesResult<double>&);

}  // namespace nmbg
