// Sums from pixels into vertices in a fixed order.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>

#include "core/bins.h"
#include "core/parallel.h"

namespace nmbg {

// Calls work(pixels, first, end) for ranges [first, end) of all vertices, with the pixels, in ascending
// order, that have a corner in the range, if any. Ranges do not overlap, so that sums into their vertices
// are equal to the last bit for any number of threads. corners(pixel, vertex) writes the K vertices of a
// pixel and returns false where the pixel is empty.
template <int K, class Corners, class Work>
void scatter_by_owner(int64_t pixels, int64_t vertices, int threads, const Corners& corners,
                      const Work& work) {
    int log_block = 6;  // of the vertices owned by one thread at a time: some thousand owners at most
    while (vertices >> log_block > 1024) ++log_block;
    const int64_t blocks = ((vertices - 1) >> log_block) + 1;

    const Bins<int32_t> bins(pixels, blocks, threads, [&](int64_t begin, int64_t end, const auto& put) {
        for (int64_t pixel = begin; pixel < end; ++pixel) {
            std::array<int32_t, K> vertex{};
            if (!corners(pixel, vertex)) continue;
            for (int k = 0; k < K; ++k) {
                const int64_t owner = vertex[k] >> log_block;
                bool seen = false;
                for (int other = 0; other < k; ++other) seen |= vertex[other] >> log_block == owner;
                if (!seen) put(owner, static_cast<int32_t>(pixel));
            }
        }
    });

    parallel_for(blocks, threads, [&](int64_t owner) {
        const int64_t first = owner << log_block, end = (owner + 1) << log_block;
        work(bins[owner], first, std::min(vertices, end));
    });
}

// Calls add(pixel, k, vertex) for each corner k of each pixel. Calls for one vertex never run at the same
// time and come in ascending order of (pixel, k).
template <int K, class Corners, class Add>
void ordered_scatter(int64_t pixels, int64_t vertices, int threads, const Corners& corners, const Add& add) {
    scatter_by_owner<K>(pixels, vertices, threads, corners,
                        [&](std::span<const int32_t> owned, int64_t first, int64_t end) {
                            for (const int32_t pixel : owned) {
                                std::array<int32_t, K> vertex{};
                                corners(pixel, vertex);
                                for (int k = 0; k < K; ++k)
                                    if (first <= vertex[k] && vertex[k] < end) add(pixel, k, vertex[k]);
                            }
                        });
}

}  // namespace nmbg
