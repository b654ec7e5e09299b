// Items placed on an image: which tiles and pixels they may touch.
#pragma once

#include <cstdint>

#include "core/pyramid.h"

namespace nmbg {

// Where on a level some faces or discs may be seen.
struct Places {
    static constexpr int most = 512;
    // A bit for each of eight: whether it may be seen. What follows is set where it is.
    uint8_t drawn[most / 8];
    // The tile that holds it; several_tiles where one is not enough or not known.
    static constexpr int32_t several_tiles = -1;
    int32_t tile[most];
    // What its depth, as it is computed at any pixel, does not go below; -∞ where that is not known.
    float nearest[most];
    // The pixels that it may cover, if it is in front.
    int32_t x0[most], y0[most], x1[most], y1[most];
    // For eight in a row, pixels in all tiles that they may cover; empty where few of them may be seen, or
    // what one may cover is not known.
    static constexpr int few = 3;
    PixelBox row[most / 8];

    PixelBox box(int i) const { return {x0[i], y0[i], x1[i], y1[i]}; }
};

}  // namespace nmbg
