// The nearest disc of each pixel, looked for among the points of the cells around it.
#pragma once

#include <cstdint>

#include "core/point_cells.h"
#include "core/pyramid.h"

namespace nmbg {

// Writes the pixels of the tile `box` of a level k that has cells: index and dist2 as for rasterize_points().
void find_discs(const PointCells& cells, double radius, const Pyramid& pyramid, std::size_t k,
                const PixelBox& box, int32_t* index, float* dist2);

}  // namespace nmbg
