#include "core/place_faces.h"

#include <limits>

#define NMBG_FILE "core/place_faces.inl"
#include "core/each_isa.h"

namespace nmbg {

bool outline(const float* h, int64_t vertices, const int32_t* faces, int n, Outlines& out) {
    NMBG_DISPATCH(outline(h, vertices, faces, n, out));
}
bool outline(const double* h, int64_t vertices, const int32_t* faces, int n, Outlines& out) {
    return portable::outline_any(h, vertices, faces, n, out);
}

void place(const Outlines& outlines, int n, const Level& level, Places& out) {
    NMBG_DISPATCH(place(outlines, n, level, out));
}

}  // namespace nmbg
