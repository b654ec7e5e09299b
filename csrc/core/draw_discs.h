// Discs around projected points: where they are, and the nearest of them in one tile.
#pragma once

#include <cstdint>
#include <span>

#include "core/hiding.h"
#include "core/places.h"
#include "core/pyramid.h"
#include "core/rasterize_points.h"
#include "core/runs.h"

namespace nmbg {

// Some projected points in the pixels of the finest level.
template <class T>
struct Points {
    T u[Places::most], v[Places::most], z[Places::most];
};

// Projects n points, h [n, 3]; z is 0 for one that is not drawn: not in front of the camera or not finite.
void project(const float* h, int n, Points<float>& out);
void project(const double* h, int n, Points<double>& out);

// Lowers, per cell, z to the nearest of n points; by several threads at a time. May keep another one where
// two threads meet.
void keep_nearest(const Points<float>& points, int n, Cells& cells);
void keep_nearest(const Points<double>& points, int n, Cells& cells);

// Places n discs of a radius in px, without those that are known to be `hidden`. `several_tiles` may have no
// pixel at all.
void place(const Points<float>& points, int n, double radius, const Level& level, const Cells* hidden,
           Places& out);
void place(const Points<double>& points, int n, double radius, const Level& level, const Cells* hidden,
           Places& out);

// Draws the discs of points into the tile `box` of a level, and writes its pixels: index and dist2 as for
// rasterize_points().
void draw_discs(const PointsView<float>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                int32_t* index, float* dist2);
void draw_discs(const PointsView<double>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                int32_t* index, double* dist2);

}  // namespace nmbg
