// Which tiles faces may touch.
#pragma once

#include <cstdint>

#include "core/places.h"

namespace nmbg {

// Corners on the image of some faces, and their view-space z; u and v are no numbers where a corner is not in
// front of the camera or not finite.
struct Outlines {
    float u[3][Places::most], v[3][Places::most], z[3][Places::most];
    // The boxes around them.
    float u0[Places::most], v0[Places::most], u1[Places::most], v1[Places::most];

    // Whether all corners of face i are in front of the camera.
    bool in_front(int i) const {
        const float sum = u[0][i] + u[1][i] + u[2][i];
        return sum == sum;
    }
};

// Projects the corners of n faces, faces [n, 3] of h [vertices, 3]. False if one names a vertex that is not
// there.
bool outline(const float* h, int64_t vertices, const int32_t* faces, int n, Outlines& out);
bool outline(const double* h, int64_t vertices, const int32_t* faces, int n, Outlines& out);

// Places n faces.
void place(const Outlines& outlines, int n, const Level& level, Places& out);

}  // namespace nmbg
