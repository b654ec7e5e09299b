#include "bind/arrays.h"
#include "core/adam_rows.h"

namespace nmbg {
namespace {

void step(py::array table, py::array mean, py::array square, const py::array& index, const py::array& grad,
          double rate, double beta1, double beta2, double eps, int threads) {
    check_threads(threads);
    with_type_of(table, "table", [&]<class T>() -> py::object {
        elements<T>(table, "table", {any, any});
        elements<T>(mean, "mean", {table.shape(0), table.shape(1)});
        elements<T>(square, "square", {table.shape(0), table.shape(1)});
        const int64_t* rows = elements<int64_t>(index, "index", {any});
        const T* grads = elements<T>(grad, "grad", {index.shape(0), table.shape(1)});
        const AdamRows<T> adam{static_cast<T*>(table.mutable_data()),
                               static_cast<T*>(mean.mutable_data()),
                               static_cast<T*>(square.mutable_data()),
                               rows,
                               grads,
                               table.shape(0),
                               index.shape(0),
                               table.shape(1),
                               beta1,
                               beta2,
                               eps,
                               rate,
                               threads};
        {
            py::gil_scoped_release release;
            adam_rows(adam);
        }
        return py::none();
    });
}

}  // namespace

void bind_adam_rows(py::module_& m) {
    m.def("adam_rows", &step, py::arg("table"), py::arg("mean"), py::arg("square"), py::arg("index"),
          py::arg("grad"), py::arg("rate"), py::arg("beta1"), py::arg("beta2"), py::arg("eps"),
          py::arg("threads"));
}

}  // namespace nmbg
