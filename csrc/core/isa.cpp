#include "core/isa.h"

#include <algorithm>
#include <cstdlib>
#include <string_view>

namespace nmbg {
namespace {

Isa widest() {
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq"))
        return Isa::avx512;
    if (__builtin_cpu_supports("avx2")) return Isa::avx2;
#endif
    return Isa::portable;
}

Isa wanted() {
    const char* value = std::getenv("NMBG_SIMD");
    for (const Isa isa : {Isa::portable, Isa::avx2})
        if (value && std::string_view(value) == name_of(isa)) return isa;
    return Isa::avx512;
}

}  // namespace

Isa isa() {
    static const Isa chosen = std::min(widest(), wanted());
    return chosen;
}

const char* name_of(Isa isa) {
    switch (isa) {
        case Isa::avx512:
            return "avx512";
        case Isa::avx2:
            return "avx2";
        default:
            return "portable";
    }
}

}  // namespace nmbg
