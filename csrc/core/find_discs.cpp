#include "core/find_discs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>

#define NMBG_FILE "core/find_discs.inl"
#include "core/each_isa.h"

namespace nmbg {

void find_discs(const PointCells& cells, double radius, const Pyramid& pyramid, std::size_t k,
                const PixelBox& box, int32_t* index, float* dist2) {
    NMBG_DISPATCH(find_discs(cells, radius, pyramid, k, box, index, dist2));
}

}  // namespace nmbg
