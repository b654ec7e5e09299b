// Projected points sorted into the pixels of coarse levels, and the nearest point of each pixel.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/pyramid.h"
#include "core/rasterize_points.h"

namespace nmbg {

// The nearest point of each cell of a level. Cells are pixels, and `margin` more on all sides: those at the
// rim of the margin also hold what lies beyond.
struct CellGrid {
    int32_t width, height, margin;      // pixels
    int32_t inner_width, inner_height;  // up to here, cells lie within the image of the first level
    int64_t stride;
    std::unique_ptr<float[]> z;          // its depth, or infinity
    std::unique_ptr<int32_t[]> nearest;  // its place among the sorted points, where there is one

    // Whether cells [x0, x1) × [y0, y1) hold nothing that stands beyond them.
    bool inner(int32_t x0, int32_t y0, int32_t x1, int32_t y1) const {
        return x0 >= 0 && y0 >= 0 && x1 <= inner_width && y1 <= inner_height;
    }
    int64_t at(int32_t x, int32_t y) const { return (y + margin) * stride + x + margin; }
};

// Points in the pixels of the levels from `first` on.
class PointCells {
  public:
    PointCells(const PointsView<float>& view, const Pyramid& pyramid, std::size_t first);

    // How many pixels away from its own a disc may reach.
    static int32_t reach(double radius);
    // Larger discs are cheaper drawn one by one.
    static constexpr int32_t farthest = 6;

    const CellGrid& grid(std::size_t level) const { return grids_[level - first_]; }
    std::size_t first() const { return first_; }

    // The sorted points: pixels of the finest level, depth, and which point it is; the last are followed by
    // room for whole vectors.
    std::unique_ptr<float[]> u, v, z;
    std::unique_ptr<int32_t[]> point;

    // Where the points of a cell of the first level begin and end.
    const int32_t* list(int32_t x, int32_t y) const { return &begin_[cell(x + margin_, y + margin_)]; }

  private:
    // Cells are sorted by tile of 32 × 16, as memory is written then.
    static constexpr int log_width = 5, log_height = 4, cells = 1 << (log_width + log_height);
    int64_t tile(int32_t column, int32_t row) const {
        return int64_t{row >> log_height} * tile_columns_ + (column >> log_width);
    }
    static int inside(int32_t column, int32_t row) {
        return ((row & ((1 << log_height) - 1)) << log_width) + (column & ((1 << log_width) - 1));
    }
    int64_t cell(int32_t column, int32_t row) const {
        return tile(column, row) * cells + inside(column, row);
    }
    void sort(const PointsView<float>& view, const Pyramid& pyramid);
    void halve(const CellGrid& fine, CellGrid& coarse, int threads) const;

    std::size_t first_;
    int32_t margin_;
    int64_t tile_columns_;
    std::vector<CellGrid> grids_;
    std::unique_ptr<int32_t[]> begin_;
};

}  // namespace nmbg
