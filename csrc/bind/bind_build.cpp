// What the extension was built with, and what this processor could do.
#include <pybind11/pybind11.h>

#include <string>

namespace nmbg {
namespace {

std::string compiled_for() {
#if defined(__AVX512F__)
    return "AVX-512";
#elif defined(__AVX2__)
    return "AVX2";
#elif defined(__SSE2__) || defined(_M_X64)
    return "SSE2";
#elif defined(__ARM_NEON)
    return "NEON";
#else
    return "scalar";
#endif
}

std::string processor_has() {
    std::string found;
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2")) found += ", AVX2";
    if (__builtin_cpu_supports("fma")) found += ", FMA";
    if (__builtin_cpu_supports("avx512f")) found += ", AVX-512";
#endif
    return found.empty() ? "" : " (this processor also has " + found.substr(2) + ")";
}

}  // namespace

void bind_build(pybind11::module_& m) {
    m.attr("version") = NMBG_VERSION;
#ifdef _OPENMP
    m.attr("openmp") = true;
#else
    m.attr("openmp") = false;
#endif
    m.attr("simd") = compiled_for() + processor_has();
}

}  // namespace nmbg
