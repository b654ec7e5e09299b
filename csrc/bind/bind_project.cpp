#include "bind/arrays.h"
#include "core/project.h"
#include "core/rays.h"

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

template <class T>
py::array_t<T> rays_of(const double* M, py::ssize_t height, py::ssize_t width, int threads) {
    py::array_t<T> out({height, width, py::ssize_t{3}});
    T* data = out.mutable_data();
    {
        py::gil_scoped_release release;
        pixel_rays(M, height, width, threads, data);
    }
    return out;
}

py::object rays(const py::array& M, int height, int width, bool single, int threads) {
    check_threads(threads);
    check_size(height, width);
    const double* matrix = elements<double>(M, "M", {3, 3});
    if (single) return rays_of<float>(matrix, height, width, threads);
    return rays_of<double>(matrix, height, width, threads);
}

}  // namespace

void bind_project(py::module_& m) {
    m.def("project", &project, py::arg("P"), py::arg("points"), py::arg("threads"));
    m.def("rays", &rays, py::arg("M"), py::arg("height"), py::arg("width"), py::arg("single"),
          py::arg("threads"));
}

}  // namespace nmbg
