// Sorting into bins, each bin in the order of the sources for any number of threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/parallel.h"

namespace nmbg {

// Lists of items, one list per bin. An item is an index or carries what its reader needs next to it: a list
// is then read from front to back, where following indices would miss the cache at each.
template <class Item>
class Bins {
  public:
    // visit(begin, end, put) calls put(bin, item) for what the sources [begin, end) of [0, n) put into bins,
    // in their order.
    template <class Visit>
    Bins(int64_t n, int64_t bins, int threads, const Visit& visit) : start_(bins + 1) {
        // More chunks than threads, since some may put more than others; short ones are not worth a visit.
        const int64_t chunks = std::clamp<int64_t>(n / 4096, 1, threads > 1 ? 4 * int64_t{threads} : 1);

        struct Put {
            int32_t bin;
            Item item;
        };
        std::vector<std::vector<Put>> puts(chunks);
        std::vector<std::vector<int32_t>> cursor(chunks);
        parallel_for(chunks, threads, [&](int64_t chunk) {
            std::vector<Put>& mine = puts[chunk];
            mine.reserve(n / chunks);
            cursor[chunk].assign(bins, 0);
            int32_t* count = cursor[chunk].data();
            visit(n * chunk / chunks, n * (chunk + 1) / chunks, [&](int64_t bin, const Item& item) {
                mine.push_back({static_cast<int32_t>(bin), item});
                ++count[bin];
            });
        });

        // Turn each chunk's counts into the places where it writes: bin by bin, chunk by chunk.
        int64_t total = 0;
        for (int64_t bin = 0; bin < bins; ++bin) {
            start_[bin] = total;
            for (auto& chunk : cursor) total += chunk[bin];
        }
        start_[bins] = total;
        std::vector<int64_t> next(start_.begin(), start_.end() - 1);
        for (auto& chunk : cursor)
            for (int64_t bin = 0; bin < bins; ++bin) {
                const int32_t count = chunk[bin];
                chunk[bin] = static_cast<int32_t>(next[bin] - start_[bin]);
                next[bin] += count;
            }

        items_ = std::make_unique_for_overwrite<Item[]>(total);
        parallel_for(chunks, threads, [&](int64_t chunk) {
            int32_t* place = cursor[chunk].data();
            for (const Put& put : puts[chunk]) items_[start_[put.bin] + place[put.bin]++] = put.item;
        });
    }

    std::span<Item> operator[](int64_t bin) const {
        return {items_.get() + start_[bin], static_cast<std::size_t>(start_[bin + 1] - start_[bin])};
    }

  private:
    std::vector<int64_t> start_;
    std::unique_ptr<Item[]> items_;
};

}  // namespace nmbg
