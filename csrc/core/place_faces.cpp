#include "core/place_faces.h"

#include <cmath>
#include <limits>

#define NMBG_FILE "core/place_faces.inl"
#include "core/each_isa.h"

namespace nmbg {

void project(const float* h, int64_t n, Screen* screen) { NMBG_DISPATCH(project(h, n, screen)); }

void project(const double* h, int64_t n, Screen* screen) { portable::project_any(h, n, screen); }

bool outline(const Screen* screen, int32_t last, const int32_t* faces, int n, Outlines& out) {
    NMBG_DISPATCH(outline(screen, last, faces, n, out));
}

void place(const Outlines& outlines, int n, const Level& level, Places& out) {
    NMBG_DISPATCH(place(outlines, n, level, out));
}

}  // namespace nmbg
