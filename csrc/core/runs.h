// What the lists of tiles hold: faces or points, one or eight in a row.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <span>

#include "core/places.h"

namespace nmbg {

// Eight in a row are listed once, as scenes are written along a Morton curve and neighbours mostly lie in the
// same tiles; others one by one.
struct Run {
    int32_t code;   // the only item, or the complement of the first of eight
    float nearest;  // no item of the run has a depth less than that

    static Run one(int32_t item, float nearest) { return {item, nearest}; }
    static Run eight(int32_t first, float nearest) { return {~first, nearest}; }
    bool single() const { return code >= 0; }
    int32_t first() const { return single() ? code : ~code; }
};

// Puts n items that are placed on a level, counted from `first`, into the lists of its tiles.
//   put(tile, run)
//   several(i): puts an item whose tile is several_tiles
template <class Put, class Several>
void list_runs(const Places& places, int n, int64_t first, const Level& level, const Put& put,
               const Several& several) {
    constexpr int most = 4;  // tiles that a run of eight is listed in
    for (int eight = 0; eight < n; eight += 8) {
        unsigned seen = places.drawn[eight / 8];
        if (!seen) continue;
        const PixelBox& box = places.row[eight / 8];
        if (eight + 8 <= n && !box.empty() && level.tiling.touched(box) <= most) {
            float z = places.nearest[eight];
            for (int i = eight + 1; i < eight + 8; ++i) z = std::min(z, places.nearest[i]);
            level.tiling.for_each(box, [&](int64_t tile) {
                put(level.first_tile + tile, Run::eight(static_cast<int32_t>(first + eight), z));
            });
            continue;
        }
        for (; seen; seen &= seen - 1) {
            const int i = eight + std::countr_zero(seen);
            if (i >= n) break;
            if (places.tile[i] != Places::several_tiles)
                put(level.first_tile + places.tile[i],
                    Run::one(static_cast<int32_t>(first + i), places.nearest[i]));
            else
                several(i);
        }
    }
}

}  // namespace nmbg
