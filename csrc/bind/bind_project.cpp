#include "bind/arrays.h"
#include "core/project.h"

namespace nmbg {
namespace {

py::object project(const py::array& P, const py::array& points, int threads) {
    check_threads(threads);
    const double* matrix = elements<double>(P, "P", {3, 4});
    return with_type_of(points, "points", [&]<class T>() -> py::object {
        const T* data = elements<T>(points, "points", {any, 3});
        py::array_t<T> h({points.shape(0), py::ssize_t{3}});
        T* h_data = h.mutable_data();
        const int64_t n = points.shape(0);
        {
            py::gil_scoped_release release;
            project_points(matrix, data, n, threads, h_data);
        }
        return h;
    });
}

}  // namespace

void bind_project(py::module_& m) {
    m.def("project", &project, py::arg("P"), py::arg("points"), py::arg("threads"));
}

}  // namespace nmbg
