// The images of a pyramid, one after another in memory, and the tiles of all of them.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "core/tiles.h"

namespace nmbg {

// Level k of a height × width image has ⌈size / 2ᵏ⌉ pixels a side; what stands at (u, v) in the finest level
// stands at (u, v) / 2ᵏ.
struct Level {
    int32_t height, width;
    double scale;         // 2⁻ᵏ
    int64_t first_pixel;  // of this level, among those of all
    int64_t first_tile;
    Tiling tiling;
};

class Pyramid {
  public:
    Pyramid(int32_t height, int32_t width, int levels) {
        for (int k = 0; k < levels; ++k) {
            const auto size = [k](int32_t whole) { return ((whole - 1) >> k) + 1; };
            const int32_t h = size(height), w = size(width);
            levels_.push_back({h, w, std::ldexp(1.0, -k), pixels_, tiles_, Tiling(h, w)});
            pixels_ += int64_t{h} * w;
            tiles_ += levels_.back().tiling.count();
        }
    }

    const std::vector<Level>& levels() const { return levels_; }
    int64_t pixels() const { return pixels_; }
    int64_t tiles() const { return tiles_; }

    // The level that a tile among those of all levels belongs to.
    const Level& of_tile(int64_t tile) const {
        std::size_t k = levels_.size() - 1;
        while (tile < levels_[k].first_tile) --k;
        return levels_[k];
    }

  private:
    std::vector<Level> levels_;
    int64_t pixels_ = 0, tiles_ = 0;
};

}  // namespace nmbg
