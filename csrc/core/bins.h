// Sorting into bins, each bin in the order of the sources for any number of threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/parallel.h"

namespace nmbg {

// Lists of items, one list per bin. An item is an index or carries what its reader needs next to it: a list
// is then read from front to back, where following indices would miss the cache at each.
template <class Item>
class Bins {
  public:
    // visit(i, put) calls put(bin, item) for each bin that source i of [0, n) goes to, the same at every
    // call. Two passes over contiguous chunks of sources: count, then fill. Memory is exactly what the lists
    // need.
    template <class Visit>
    Bins(int64_t n, int64_t bins, int threads, const Visit& visit) : start_(bins + 1) {
        // Fewer sources are not worth a thread.
        threads = static_cast<int>(std::clamp<int64_t>(n / 4096, 1, threads));

        std::vector<std::vector<int64_t>> cursor(threads);
        parallel_chunks(n, threads, [&](int64_t chunk, int64_t begin, int64_t end) {
            cursor[chunk].assign(bins, 0);
            int64_t* count = cursor[chunk].data();
            for (int64_t i = begin; i < end; ++i)
                visit(i, [count](int64_t bin, const Item&) { ++count[bin]; });
        });

        // Turn each chunk's counts into the places where it writes: bin by bin, chunk by chunk.
        int64_t total = 0;
        for (int64_t bin = 0; bin < bins; ++bin) {
            start_[bin] = total;
            for (auto& chunk : cursor) {
                const int64_t count = chunk[bin];
                chunk[bin] = total;
                total += count;
            }
        }
        start_[bins] = total;

        items_.resize(total);
        parallel_chunks(n, threads, [&](int64_t chunk, int64_t begin, int64_t end) {
            int64_t* place = cursor[chunk].data();
            for (int64_t i = begin; i < end; ++i)
                visit(i, [&](int64_t bin, const Item& item) { items_[place[bin]++] = item; });
        });
    }

    std::span<const Item> operator[](int64_t bin) const {
        return {items_.data() + start_[bin], static_cast<std::size_t>(start_[bin + 1] - start_[bin])};
    }

  private:
    std::vector<int64_t> start_;
    std::vector<Item> items_;
};

}  // namespace nmbg
