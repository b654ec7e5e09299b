// One triangle in homogeneous pixels, and the pixels that it may reach.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/portable.h"
#include "core/rasterize_faces.h"

namespace nmbg {

using portable::Corners;
using portable::Triangle;
using portable::Vec3;

// The corners of a face whose vertices exist, in the pixels of a level.
template <class T>
Corners<double> corners_of(const FacesView<T>& view, double scale, int64_t face) {
    Corners<double> corners;
    for (int k = 0; k < 3; ++k) {
        const T* h = view.h + 3 * int64_t{view.faces[3 * face + k]};
        corners.at[k] = {h[0] * scale, h[1] * scale, double{h[2]}};
    }
    return corners;
}

// Where the face leaves towards the camera plane along the edge from `front` (z > 0) to `back` (z <= 0), its
// projection runs to infinity: the sign of the direction along x or y, 0 if it stays at the front's
// coordinate.
inline int direction_to_infinity(double front, double front_z, double back, double back_z) {
    const double a = front_z * back, b = back_z * front;
    return (a > b) - (a < b);
}

// Every pixel that a face may cover; empty for one that is not drawn.
inline PixelBox reach(const Corners<double>& corners, int32_t width, int32_t height) {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    double xmin = infinity, ymin = infinity, xmax = -infinity, ymax = -infinity;
    for (int k = 0; k < 3; ++k) {
        const Vec3<double>& front = corners[k];
        if (!std::isfinite(front.x) || !std::isfinite(front.y) || !std::isfinite(front.z)) return {};
        if (front.z <= 0) continue;
        const double u = front.x / front.z, v = front.y / front.z;
        xmin = std::min(xmin, u), xmax = std::max(xmax, u);
        ymin = std::min(ymin, v), ymax = std::max(ymax, v);
        for (int other = 1; other < 3; ++other) {
            const Vec3<double>& back = corners[(k + other) % 3];
            if (back.z > 0) continue;
            const int dx = direction_to_infinity(front.x, front.z, back.x, back.z);
            const int dy = direction_to_infinity(front.y, front.z, back.y, back.z);
            if (dx < 0) xmin = -infinity;
            if (dx > 0) xmax = infinity;
            if (dy < 0) ymin = -infinity;
            if (dy > 0) ymax = infinity;
        }
    }
    if (!(xmin <= xmax && ymin <= ymax)) return {};
    return pixels_within(xmin, ymin, xmax, ymax, width, height);
}

// False only when no pixel centre of the box is inside.
inline bool may_cover(const Triangle<double>& t, const PixelBox& box) {
    for (int k = 0; k < 3; ++k) {
        const double x = (t.a[k] > 0 ? box.x1 - 1 : box.x0) + 0.5;
        const double y = (t.b[k] > 0 ? box.y1 - 1 : box.y0) + 0.5;
        if (t.edge(k, x, y) < 0) return false;
    }
    return true;
}

}  // namespace nmbg
