#include "bind/arrays.h"
#include "core/gate.h"

namespace nmbg {
namespace {

int channels_of(const py::array& x) {
    if (x.ndim() != 2 || x.shape(1) % 2 || x.shape(1) > std::numeric_limits<int32_t>::max())
        throw py::value_error("x: expected shape [*, an even number], got " +
                              shape_text(x.shape(), x.ndim()));
    return static_cast<int>(x.shape(1) / 2);
}

// Results are written into arrays that come: torch allocates them, in huge pages.
void forward(const py::array& x, py::array out, int threads) {
    check_threads(threads);
    const int channels = channels_of(x);
    with_type_of(x, "x", [&]<class T>() -> py::object {
        const T* from = elements<T>(x, "x", {any, any});
        elements<T>(out, "out", {x.shape(0), channels});
        T* to = static_cast<T*>(out.mutable_data());
        {
            py::gil_scoped_release release;
            gate(from, x.shape(0), channels, threads, to);
        }
        return py::none();
    });
}

void backward(const py::array& x, const py::array& grad_out, py::array grad, int threads) {
    check_threads(threads);
    const int channels = channels_of(x);
    with_type_of(x, "x", [&]<class T>() -> py::object {
        const T* from = elements<T>(x, "x", {any, any});
        const T* down = elements<T>(grad_out, "grad_out", {x.shape(0), channels});
        elements<T>(grad, "grad", {x.shape(0), x.shape(1)});
        T* to = static_cast<T*>(grad.mutable_data());
        {
            py::gil_scoped_release release;
            gate_backward(from, down, x.shape(0), channels, threads, to);
        }
        return py::none();
    });
}

}  // namespace

void bind_gate(py::module_& m) {
    m.def("gate", &forward, py::arg("x"), py::arg("out"), py::arg("threads"));
    m.def("gate_backward", &backward, py::arg("x"), py::arg("grad_out"), py::arg("grad"), py::arg("threads"));
}

}  // namespace nmbg
