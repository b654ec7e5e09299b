// Which tiles faces may touch.
#pragma once

#include <cstdint>

#include "core/places.h"

namespace nmbg {

// A vertex on the image; not a number where it is not in front of the camera or not finite.
struct Screen {
    float u, v;
};

// h [n, 3] → screen [n].
void project(const float* h, int64_t n, Screen* screen);
void project(const double* h, int64_t n, Screen* screen);

// Corners on the image of some faces.
struct Outlines {
    float u[3][Places::most], v[3][Places::most];

    // Whether all corners of face i are in front of the camera.
    bool in_front(int i) const {
        const float sum = u[0][i] + u[1][i] + u[2][i];
        return sum == sum;
    }
};

// Writes the outlines of n faces. False if one names a vertex beyond `last`.
bool outline(const Screen* screen, int32_t last, const int32_t* faces, int n, Outlines& out);

// Places n faces.
void place(const Outlines& outlines, int n, const Level& level, Places& out);

}  // namespace nmbg
