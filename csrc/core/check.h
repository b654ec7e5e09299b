// Checks of indices when they are followed.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

namespace nmbg {

[[noreturn]] inline void refuse_index(const char* name, int32_t index, int32_t lowest, int64_t end) {
    throw std::invalid_argument(std::string(name) + ": expected indices from " + std::to_string(lowest) +
                                " to " + std::to_string(end - 1) + ", got " + std::to_string(index));
}

// The index itself if lowest <= index < end; throws std::invalid_argument otherwise.
inline int32_t checked(const char* name, int32_t index, int32_t lowest, int64_t end) {
    if (index < lowest || index >= end) [[unlikely]]
        refuse_index(name, index, lowest, end);
    return index;
}

}  // namespace nmbg
