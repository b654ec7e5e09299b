// The image cut into tiles of 256 pixels. A tile is worked on by one thread at a time, which owns its pixels.
#pragma once

#include <algorithm>
#include <cstdint>

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

// The first pixel of [0, size] whose centre is at `x` or beyond; x may be infinite.
inline int32_t first_pixel_from(double x, int32_t size) {
    const double bounded = std::clamp(x - 0.5, 0.0, static_cast<double>(size));
    const auto pixel = static_cast<int32_t>(bounded);
    return pixel + (pixel < bounded);
}

// The pixels of a width × height image whose centres lie in [xmin, xmax] × [ymin, ymax], or a little beyond.
inline PixelBox pixels_within(double xmin, double ymin, double xmax, double ymax, int32_t width,
                              int32_t height) {
    // Wider than any rounding of the exact tests that follow, narrower than what would slow them down.
    constexpr double margin = 1.0 / 64;
    return {first_pixel_from(xmin - margin, width), first_pixel_from(ymin - margin, height),
            first_pixel_from(xmax + margin, width), first_pixel_from(ymax + margin, height)};
}

class Tiling {
  public:
    static constexpr int pixels = 256;  // of a tile

    // Square tiles; flat or upright ones for strips, so that they too have enough tiles to share out.
    Tiling(int32_t height, int32_t width) : height_(height), width_(width) {
        while (log_height_ > 0 && height <= 1 << (log_height_ - 1)) --log_height_, ++log_width_;
        while (log_width_ > 0 && width <= 1 << (log_width_ - 1)) --log_width_, ++log_height_;
        columns_ = ((width - 1) >> log_width_) + 1;
        rows_ = ((height - 1) >> log_height_) + 1;
    }

    int64_t count() const { return int64_t{columns_} * rows_; }

    PixelBox box(int64_t tile) const {
        const auto x = static_cast<int32_t>(tile % columns_) << log_width_;
        const auto y = static_cast<int32_t>(tile / columns_) << log_height_;
        return {x, y, std::min(x + (1 << log_width_), width_), std::min(y + (1 << log_height_), height_)};
    }

    // The place of pixel (x, y) in a buffer of one tile.
    int slot(const PixelBox& tile, int32_t x, int32_t y) const {
        return ((y - tile.y0) << log_width_) + (x - tile.x0);
    }

    // The tile of pixel (x, y).
    int64_t of(int32_t x, int32_t y) const {
        return int64_t{y >> log_height_} * columns_ + (x >> log_width_);
    }

    bool within_one(const PixelBox& box) const { return of(box.x0, box.y0) == of(box.x1 - 1, box.y1 - 1); }

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
    int log_width_ = 4, log_height_ = 4;  // of the size of a tile
    int32_t columns_, rows_;
};

}  // namespace nmbg
