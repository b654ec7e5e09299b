#include "core/draw_discs.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#define NMBG_FILE "core/draw_discs.inl"
#include "core/each_isa.h"

namespace nmbg {

void project(const float* h, int n, Points<float>& out) { NMBG_DISPATCH(project(h, n, out)); }
void project(const double* h, int n, Points<double>& out) { portable::project_points(h, n, out); }

void keep_nearest(const Points<float>& points, int n, Cells& cells) {
    NMBG_DISPATCH(keep_nearest(points, n, cells));
}
void keep_nearest(const Points<double>& points, int n, Cells& cells) {
    portable::keep_any_nearest(points, n, cells);
}

void place(const Points<float>& points, int n, double radius, const Level& level, const Cells* hidden,
           Places& out) {
    NMBG_DISPATCH(place(points, n, radius, level, hidden, out));
}
void place(const Points<double>& points, int n, double radius, const Level& level, const Cells* hidden,
           Places& out) {
    portable::place_discs(points, n, radius, level, hidden, out);
}

void draw_discs(const PointsView<float>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                int32_t* index, float* dist2) {
    NMBG_DISPATCH(draw_discs(view, level, box, runs, index, dist2));
}
void draw_discs(const PointsView<double>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                int32_t* index, double* dist2) {
    portable::draw_any_discs(view, level, box, runs, index, dist2);
}

}  // namespace nmbg
