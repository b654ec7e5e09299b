#include <cmath>

#include "bind/arrays.h"
#include "core/pyramid.h"
#include "core/rasterize_points.h"

namespace nmbg {
namespace {

template <class T>
PointsView<T> points_view(const py::array& h, double radius, int64_t height, int64_t width, int levels,
                          int threads) {
    check_size(height, width);
    check_levels(levels);
    check_threads(threads);
    if (!std::isfinite(radius) || radius <= 0)
        throw py::value_error("radius_px: expected a positive number, got " + std::to_string(radius));
    const T* data = elements<T>(h, "h", {any, 3});
    check_count(h.shape(0), "h");
    return {data,   h.shape(0), radius, static_cast<int32_t>(height), static_cast<int32_t>(width),
            levels, threads};
}

py::object forward(const py::array& h, double radius, int64_t height, int64_t width, int levels,
                   int threads) {
    return with_type_of(h, "h", [&]<class T>() -> py::object {
        const PointsView<T> view = points_view<T>(h, radius, height, width, levels, threads);
        const int64_t pixels = Pyramid(view.height, view.width, levels).pixels();
        py::array_t<int32_t> index(pixels);
        py::array_t<T> dist2(pixels);
        int32_t* index_data = index.mutable_data();
        T* dist2_data = dist2.mutable_data();
        {
            py::gil_scoped_release release;
            rasterize_points(view, index_data, dist2_data);
        }
        return py::make_tuple(index, dist2);
    });
}

py::object backward(const py::array& h, double radius, int64_t height, int64_t width, int levels,
                    const py::array& index, const py::array& grad_dist2, int threads) {
    return with_type_of(h, "h", [&]<class T>() -> py::object {
        const PointsView<T> view = points_view<T>(h, radius, height, width, levels, threads);
        const int64_t pixels = Pyramid(view.height, view.width, levels).pixels();
        const int32_t* index_data = elements<int32_t>(index, "index", {pixels});
        const T* grad_data = elements<T>(grad_dist2, "grad_dist2", {pixels});
        py::array_t<T> grad_h = zeros<T>({view.points, 3});
        T* grad_h_data = grad_h.mutable_data();
        {
            py::gil_scoped_release release;
            rasterize_points_backward(view, index_data, grad_data, grad_h_data);
        }
        return grad_h;
    });
}

}  // namespace

void bind_rasterize_points(py::module_& m) {
    m.def("rasterize_points", &forward, py::arg("h"), py::arg("radius_px"), py::arg("height"),
          py::arg("width"), py::arg("levels"), py::arg("threads"));
    m.def("rasterize_points_backward", &backward, py::arg("h"), py::arg("radius_px"), py::arg("height"),
          py::arg("width"), py::arg("levels"), py::arg("index"), py::arg("grad_dist2"), py::arg("threads"));
}

}  // namespace nmbg
