// Sums from pixels into vertices in a fixed order.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "core/bins.h"
#include "core/parallel.h"

namespace nmbg {

// Calls add(pixel, k, vertex) for each corner k of each pixel. Calls for one vertex never run at the same
// time and come in ascending order of (pixel, k), so that sums are equal to the last bit for any number of
// threads. corners(pixel, vertex) writes the K vertices of a pixel and returns false where the pixel is
// empty.
template <int K, class Corners, class Add>
void ordered_scatter(int64_t pixels, int64_t vertices, int threads, const Corners& corners, const Add& add) {
    const int64_t block = std::max<int64_t>(64, vertices / 1024);  // vertices owned by one thread at a time
    const int64_t blocks = (vertices + block - 1) / block;

    const Bins<int32_t> bins(pixels, blocks, threads, [&](int64_t begin, int64_t end, const auto& put) {
        for (int64_t pixel = begin; pixel < end; ++pixel) {
            std::array<int32_t, K> vertex{};
            if (!corners(pixel, vertex)) continue;
            for (int k = 0; k < K; ++k) {
                const int64_t owner = vertex[k] / block;
                bool seen = false;
                for (int other = 0; other < k; ++other) seen |= vertex[other] / block == owner;
                if (!seen) put(owner, static_cast<int32_t>(pixel));
            }
        }
    });

    parallel_for(blocks, threads, [&](int64_t owner) {
        for (const int32_t pixel : bins[owner]) {
            std::array<int32_t, K> vertex{};
            corners(pixel, vertex);
            for (int k = 0; k < K; ++k)
                if (vertex[k] / block == owner) add(pixel, k, vertex[k]);
        }
    });
}

}  // namespace nmbg
