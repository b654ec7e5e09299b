// Loops over threads. Without OpenMP they are plain loops.
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>

namespace nmbg {

// Calls body(i) for i in [0, n) on `threads` threads, in no particular order.
// The first exception of a body is thrown again here: none may leave an OpenMP region.
template <class Body>
void parallel_for(int64_t n, [[maybe_unused]] int threads, const Body& body) {
    std::exception_ptr error;
#pragma omp parallel for num_threads(threads) schedule(dynamic, 1) if (threads > 1 && n > 1)
    for (int64_t i = 0; i < n; ++i) {
        try {
            body(i);
        } catch (...) {
#pragma omp critical(nmbg_parallel_for)
            if (!error) error = std::current_exception();
        }
    }
    if (error) std::rethrow_exception(error);
}

// Calls body(begin, end) for blocks of [0, n) that are long enough to be worth a thread's visit.
template <class Body>
void parallel_blocks(int64_t n, int threads, const Body& body) {
    constexpr int64_t length = 2048;
    parallel_for((n + length - 1) / length, threads,
                 [&](int64_t block) { body(block * length, std::min(n, (block + 1) * length)); });
}

}  // namespace nmbg
