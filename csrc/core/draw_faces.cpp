#include "core/draw_faces.h"

#include <algorithm>
#include <bit>

#define NMBG_FILE "core/draw_faces.inl"
#include "core/each_isa.h"

namespace nmbg {

void draw_faces(const FacesView<float>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                const FacesResult<float>& out) {
    NMBG_DISPATCH(draw_faces(view, level, box, runs, out));
}

void draw_faces(const FacesView<double>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                const FacesResult<double>& out) {
    portable::draw_any(view, level, box, runs, out);
}

}  // namespace nmbg
