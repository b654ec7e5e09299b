#include "bind/arrays.h"
#include "core/bfloat.h"
#include "core/gate.h"

namespace nmbg {
namespace {

int channels_of(const py::array& x) {
    if (x.ndim() != 2 || x.shape(1) % 2 || x.shape(1) > std::numeric_limits<int32_t>::max())
        throw py::value_error("x: expected shape [*, an even number], got " +
                              shape_text(x.shape(), x.ndim()));
    return static_cast<int>(x.shape(1) / 2);
}

// Calls body.template operator()<Element, T>() with the type of an array's elements and what they stand for:
// NumPy has no bfloat16, so its bits come.
template <class Body>
void with_elements_of(const py::array& x, const Body& body) {
    if (py::isinstance<py::array_t<uint16_t>>(x))
        body.template operator()<uint16_t, Bfloat>();
    else
        with_type_of(x, "x", [&]<class T>() -> py::object {
            body.template operator()<T, T>();
            return py::none();
        });
}

// Results are written into arrays that come: torch allocates them, in huge pages.
void forward(const py::array& x, py::array out, int threads) {
    check_threads(threads);
    const int channels = channels_of(x);
    with_elements_of(x, [&]<class Element, class T>() {
        const auto* from = reinterpret_cast<const T*>(elements<Element>(x, "x", {any, any}));
        elements<Element>(out, "out", {x.shape(0), channels});
        auto* to = static_cast<T*>(out.mutable_data());
        const py::gil_scoped_release release;
        gate(from, x.shape(0), channels, threads, to);
    });
}

void backward(const py::array& x, const py::array& grad_out, py::array grad, int threads) {
    check_threads(threads);
    const int channels = channels_of(x);
    with_elements_of(x, [&]<class Element, class T>() {
        const auto* from = reinterpret_cast<const T*>(elements<Element>(x, "x", {any, any}));
        const auto* down =
            reinterpret_cast<const T*>(elements<Element>(grad_out, "grad_out", {x.shape(0), channels}));
        elements<Element>(grad, "grad", {x.shape(0), x.shape(1)});
        auto* to = static_cast<T*>(grad.mutable_data());
        const py::gil_scoped_release release;
        gate_backward(from, down, x.shape(0), channels, threads, to);
    });
}

}  // namespace

void bind_gate(py::module_& m) {
    m.def("gate", &forward, py::arg("x"), py::arg("out"), py::arg("threads"));
    m.def("gate_backward", &backward, py::arg("x"), py::arg("grad_out"), py::arg("grad"), py::arg("threads"));
}

}  // namespace nmbg
