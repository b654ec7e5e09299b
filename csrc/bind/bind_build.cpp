// What the extension was built with, and which instructions it uses.
#include <pybind11/pybind11.h>

#include "core/isa.h"

namespace nmbg {

void bind_build(pybind11::module_& m) {
    m.attr("version") = NMBG_VERSION;
#ifdef _OPENMP
    m.attr("openmp") = true;
#else
    m.attr("openmp") = false;
#endif
    m.attr("simd") = name_of(isa());
}

}  // namespace nmbg
