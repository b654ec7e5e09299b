#include "core/place_faces.h"

#include <cmath>
#include <limits>

#define NMBG_FILE "core/place_faces.inl"
#include "core/each_isa.h"

namespace nmbg {

void project(const float* h, int64_t n, Screen* screen) { NMBG_DISPATCH(project(h, n, screen)); }

void project(const double* h, int64_t n, Screen* screen) { portable::project_any(h, n, screen); }

bool measure(const Screen* screen, uint32_t last, const int32_t* faces, int n, Extents& out) {
    NMBG_DISPATCH(measure(screen, last, faces, n, out));
}

PixelBox box_of(const Extents& extents, int i, const Level& level) {
    const auto box = portable::box_at<float>(extents, i, level);
    return {box.x0, box.y0, box.x1, box.y1};
}

void place(const Extents& extents, int n, const Level& level, int32_t* holder) {
    NMBG_DISPATCH(place(extents, n, level, holder));
}

}  // namespace nmbg
