// What nearer points hide for certain on the coarse levels of a pyramid: discs have the same radius in pixels
// on each, so that these hold all points on few pixels. It only saves work: what is hidden wins no pixel.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/pyramid.h"
#include "core/rasterize_points.h"

namespace nmbg {

// A level cut into cells, 2ˢ × 2ˢ a pixel; a number for each.
struct Cells {
    int32_t height, width;
    float per_pixel;  // of the finest level
    std::vector<float> z;
};

class Hiding {
  public:
    template <class T>
    Hiding(const PointsView<T>& view, const Pyramid& pyramid);

    // Per cell of level k, the z beyond which a point in it wins no pixel; null where that is not known.
    const Cells* of(std::size_t k) const {
        return k < first_ || levels_.empty() ? nullptr : &levels_[k - first_];
    }

  private:
    std::size_t first_ = 0;
    std::vector<Cells> levels_;
};

}  // namespace nmbg
