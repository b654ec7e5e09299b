// The nearest faces in one tile.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>

#include "core/pyramid.h"
#include "core/rasterize_faces.h"
#include "core/runs.h"

namespace nmbg {

// What the pixels of a tile see so far: the face, its depth, and its edges there. Slots as in Tiling.
struct FaceTile {
    alignas(64) std::array<double, Tiling::pixels> depth, e0, e1, e2;
    alignas(64) std::array<int32_t, Tiling::pixels> face;
};

// Draws faces into the tile `box` of a level, and writes its pixels. Every vertex that a face names must
// exist.
void draw_faces(const FacesView<float>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                const FacesResult<float>& out);
void draw_faces(const FacesView<double>& view, const Level& level, const PixelBox& box, std::span<Run> runs,
                const FacesResult<double>& out);

}  // namespace nmbg
