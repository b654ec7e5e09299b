// Items placed on an image: which tiles and pixels they may touch.
#pragma once

#include <bit>
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
    // The pixels that it may cover, if it is in front.
    int32_t x0[most], y0[most], x1[most], y1[most];

    PixelBox box(int i) const { return {x0[i], y0[i], x1[i], y1[i]}; }

    // Calls visit(i) for each of n items that may be seen, in ascending order.
    template <class Visit>
    void for_each(int n, const Visit& visit) const {
        for (int eight = 0; eight < n; eight += 8)
            for (unsigned seen = drawn[eight / 8]; seen; seen &= seen - 1) {
                const int i = eight + std::countr_zero(seen);
                if (i < n) visit(i);
            }
    }
};

}  // namespace nmbg
