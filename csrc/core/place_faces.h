// Which tiles faces may touch.
#pragma once

#include <cstdint>

#include "core/pyramid.h"

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
    static constexpr int most = 512;  // faces
    float u[3][most], v[3][most];

    // Whether all corners of face i are in front of the camera.
    bool in_front(int i) const {
        const float sum = u[0][i] + u[1][i] + u[2][i];
        return sum == sum;
    }
};

// Writes the outlines of n faces. False if one names a vertex beyond `last`.
bool outline(const Screen* screen, int32_t last, const int32_t* faces, int n, Outlines& out);

// Where on a level some faces may be seen.
struct Places {
    // A bit for each of eight faces: whether it may be seen. What follows is set where it is.
    uint8_t drawn[Outlines::most / 8];
    // The tile that holds a face; several_tiles where one is not enough or not known.
    static constexpr int32_t several_tiles = -1;
    int32_t tile[Outlines::most];
    // The pixels that it may cover, if it is in front.
    int32_t x0[Outlines::most], y0[Outlines::most], x1[Outlines::most], y1[Outlines::most];

    PixelBox box(int i) const { return {x0[i], y0[i], x1[i], y1[i]}; }
};

// Places n faces.
void place(const Outlines& outlines, int n, const Level& level, Places& out);

}  // namespace nmbg
