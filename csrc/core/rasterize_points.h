// Discs of constant radius around projected points; the nearest one wins each pixel.
#pragma once

#include <cstdint>

namespace nmbg {

// The problem. T is float or double.
template <class T>
struct PointsView {
    const T* h;  // [points, 3] homogeneous pixels (u z, v z, z) of the finest level
    int64_t points;
    double radius;          // px of each level; a point covers the pixels whose centre is strictly nearer
    int32_t height, width;  // of the finest level
    int levels;             // of the pyramid (see Pyramid)
    int threads;
};

// h → discs and the tiles they touch → per tile, nearer ones first: test, keep the nearest z, of equal ones
// the lowest point.
//   index [pixels of all levels]: the point, or -1
//   dist2 [pixels of all levels]: squared distance in px² from the projected point to the pixel centre, or 0
template <class T>
void rasterize_points(const PointsView<T>& view, int32_t* index, T* dist2);

// Gradient of dist2 with respect to h.
//   index [pixels], grad_dist2 [pixels] → grad_h [points, 3], which comes zeroed
template <class T>
void rasterize_points_backward(const PointsView<T>& view, const int32_t* index, const T* grad_dist2,
                               T* grad_h);

}  // namespace nmbg
