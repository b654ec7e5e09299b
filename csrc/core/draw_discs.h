// Discs around projected points: where they are, and the nearest of them in one tile.
#pragma once

#include <cstdint>
#include <span>

#include "core/places.h"
#include "core/pyramid.h"

namespace nmbg {

// A projected point in the pixels of a level.
template <class T>
struct Disc {
    T u, v, z;
    int32_t point;
};

// Some projected points in the pixels of the finest level.
template <class T>
struct Points {
    T u[Places::most], v[Places::most], z[Places::most];
};

// Projects n points, h [n, 3]; z is 0 for one that is not drawn: not in front of the camera or not finite.
void project(const float* h, int n, Points<float>& out);
void project(const double* h, int n, Points<double>& out);

// Places n discs of a radius in px. `several_tiles` may have no pixel at all.
void place(const Points<float>& points, int n, double radius, const Level& level, Places& out);
void place(const Points<double>& points, int n, double radius, const Level& level, Places& out);

// Draws discs, in ascending order of point, into the tile `box` of a level, and writes its pixels: index and
// dist2 as for rasterize_points().
void draw_discs(const Level& level, const PixelBox& box, double radius, std::span<const Disc<float>> discs,
                int32_t* index, float* dist2);
void draw_discs(const Level& level, const PixelBox& box, double radius, std::span<const Disc<double>> discs,
                int32_t* index, double* dist2);

}  // namespace nmbg
