// Checks of indices before they are followed.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

#include "core/parallel.h"

namespace nmbg {

// Throws std::invalid_argument unless lowest <= values[i] < end for all i.
inline void check_indices(const char* name, const int32_t* values, int64_t n, int32_t lowest, int64_t end,
                          int threads) {
    parallel_blocks(n, threads, [&](int64_t begin, int64_t stop) {
        for (int64_t i = begin; i < stop; ++i)
            if (values[i] < lowest || values[i] >= end)
                throw std::invalid_argument(std::string(name) + ": expected indices from " +
                                            std::to_string(lowest) + " to " + std::to_string(end - 1) +
                                            ", got " + std::to_string(values[i]));
    });
}

}  // namespace nmbg
