// Discs of constant radius around projected points; the nearest one wins each pixel.
#pragma once

#include <cstdint>

namespace nmbg {

// The problem. T is float or double.
template <class T>
struct PointsView {
    const T* h;  // [points, 3] homogeneous pixels (u z, v z, z)
    int64_t points;
    double radius;          // px; a point covers the pixels whose centre is strictly nearer than this
    int32_t height, width;  // of the image
    int threads;
};

// h → discs and the tiles they touch → per tile, in ascending order of point: test, keep the nearest z.
//   index [height, width]: the point, or -1
//   dist2 [height, width]: squared distance in px² from the projected point to the pixel centre, or 0
template <class T>
void rasterize_points(const PointsView<T>& view, int32_t* index, T* dist2);

// Gradient of dist2 with respect to h.
//   index [height, width], grad_dist2 [height, width] → grad_h [points, 3]
template <class T>
void rasterize_points_backward(const PointsView<T>& view, const int32_t* index, const T* grad_dist2,
                               T* grad_h);

}  // namespace nmbg
