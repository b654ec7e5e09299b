// The extension nmbg._core: registers what the other files bind.
#include <pybind11/pybind11.h>

namespace nmbg {
void bind_adam_rows(pybind11::module_& m);
void bind_blend_photos(pybind11::module_& m);
void bind_build(pybind11::module_& m);
void bind_gate(pybind11::module_& m);
void bind_project(pybind11::module_& m);
void bind_rasterize_faces(pybind11::module_& m);
void bind_rasterize_points(pybind11::module_& m);
void bind_shade(pybind11::module_& m);
}  // namespace nmbg

PYBIND11_MODULE(_core, m) {
    m.doc() = "Kernels of nmbg over NumPy arrays; nmbg.ops wraps them for torch.";
    nmbg::bind_build(m);
    nmbg::bind_project(m);
    nmbg::bind_rasterize_points(m);
    nmbg::bind_rasterize_faces(m);
    nmbg::bind_shade(m);
    nmbg::bind_blend_photos(m);
    nmbg::bind_adam_rows(m);
    nmbg::bind_gate(m);
}
