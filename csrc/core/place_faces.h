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

// Extents on the image of some faces.
struct Extents {
    static constexpr int most = 512;  // faces
    float umin[most], vmin[most], umax[most], vmax[most];

    // Whether all corners of face i are in front of the camera.
    bool in_front(int i) const { return umin[i] == umin[i]; }
};

// Writes the extents of n faces; umin is not a number for one with a corner that is nowhere. False if one names
// a vertex beyond `last`.
bool measure(const Screen* screen, uint32_t last, const int32_t* faces, int n, Extents& out);

// The pixels of a level that face i may cover, if it is in front.
PixelBox box_of(const Extents& extents, int i, const Level& level);

constexpr int32_t no_tile = -1, several_tiles = -2;

// The tile of the level that holds each face; no_tile for one that holds no pixel centre, several_tiles where
// one tile is not enough or not known.
void place(const Extents& extents, int n, const Level& level, int32_t* holder);

}  // namespace nmbg
