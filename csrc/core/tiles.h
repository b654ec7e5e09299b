// The image cut into tiles of 512 pixels. A tile is worked on by one thread at a time, which owns its pixels.
#pragma once

#include <algorithm>
#include <cstdint>

#include "core/portable.h"

namespace nmbg {

// Pixels [x0, x1) × [y0, y1).
struct PixelBox {
    int32_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;

    bool empty() const { return x0 >= x1 || y0 >= y1; }

    PixelBox intersected(const PixelBox& other) const {
        return {std::max(x0, other.x0), std::max(y0, other.y0), std::min(x1, other.x1),
                std::min(y1, other.y1)};
    }
};

// The pixels of a width × height image whose centres lie in [xmin, xmax] × [ymin, ymax], or a little beyond.
template <class S>
PixelBox pixels_within(S xmin, S ymin, S xmax, S ymax, int32_t width, int32_t height) {
    const auto box = portable::pixels_within<S>(xmin, ymin, xmax, ymax, width, height);
    return {box.x0, box.y0, box.x1, box.y1};
}

class Tiling {
  public:
    static constexpr int pixels = 512;  // of a tile

    // Tiles of 32 × 16 pixels; flat or upright ones for strips, so that they too have enough tiles to share
    // out; always whole vectors wide.
    Tiling(int32_t height, int32_t width) : height_(height), width_(width) {
        while (log_height_ > 0 && height <= 1 << (log_height_ - 1)) --log_height_, ++log_width_;
        while (1 << log_width_ > portable::wide && width <= 1 << (log_width_ - 1))
            --log_width_, ++log_height_;
        columns_ = ((width - 1) >> log_width_) + 1;
        rows_ = ((height - 1) >> log_height_) + 1;
    }

    int64_t count() const { return int64_t{columns_} * rows_; }

    PixelBox box(int64_t tile) const {
        const auto x = static_cast<int32_t>(tile % columns_) << log_width_;
        const auto y = static_cast<int32_t>(tile / columns_) << log_height_;
        return {x, y, std::min(x + (1 << log_width_), width_), std::min(y + (1 << log_height_), height_)};
    }

    // Tiles are counted along the rows of their grid; their sides are powers of two.
    int columns() const { return columns_; }
    int log_width() const { return log_width_; }
    int log_height() const { return log_height_; }

    // Numbers from one row of a tile's buffer to the next.
    int stride() const { return 1 << log_width_; }

    // How many tiles a box of pixels touches.
    int64_t touched(const PixelBox& box) const {
        if (box.empty()) return 0;
        return int64_t{((box.y1 - 1) >> log_height_) - (box.y0 >> log_height_) + 1} *
               (((box.x1 - 1) >> log_width_) - (box.x0 >> log_width_) + 1);
    }

    // Calls visit(tile) for each tile that a box of pixels touches.
    template <class Visit>
    void for_each(const PixelBox& box, const Visit& visit) const {
        if (box.empty()) return;
        for (int32_t row = box.y0 >> log_height_; row <= (box.y1 - 1) >> log_height_; ++row)
            for (int32_t column = box.x0 >> log_width_; column <= (box.x1 - 1) >> log_width_; ++column)
                visit(int64_t{row} * columns_ + column);
    }

  private:
    int32_t height_, width_;
    int log_width_ = 5, log_height_ = 4;  // of the size of a tile
    int32_t columns_, rows_;
};

}  // namespace nmbg
