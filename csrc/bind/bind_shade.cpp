#include <optional>

#include "bind/arrays.h"
#include "core/shade.h"

namespace nmbg {
namespace {

// index [H, W], weight [H, W, K], faces [M, 3] or None, rays [H, W, 3], coeffs [N, B, C]
struct Arguments {
    py::array index, weight;
    std::optional<py::array> faces;
    py::array rays, coeffs;
    int threads;

    py::ssize_t height() const { return index.shape(0); }
    py::ssize_t width() const { return index.shape(1); }
    py::ssize_t corners() const { return faces ? 3 : 1; }

    template <class T>
    Shading<T> checked() const {
        check_threads(threads);
        Shading<T> shading{};
        shading.index = elements<int32_t>(index, "index", {any, any});
        check_size(height(), width());
        shading.weight = elements<T>(weight, "weight", {height(), width(), corners()});
        shading.rays = elements<T>(rays, "rays", {height(), width(), 3});
        shading.coeffs = elements<T>(coeffs, "coeffs", {any, any, any});
        check_count(coeffs.shape(0), "coeffs");
        if (faces) {
            shading.faces = elements<int32_t>(*faces, "faces", {any, 3});
            shading.face_count = faces->shape(0);
            check_count(shading.face_count, "faces");
        }
        shading.pixels = height() * width();
        shading.vertices = coeffs.shape(0);
        shading.basis = static_cast<int>(coeffs.shape(1));
        shading.channels = static_cast<int>(coeffs.shape(2));
        shading.threads = threads;
        return shading;
    }

    template <class T>
    const T* checked_grad(const py::array& grad_out) const {
        return elements<T>(grad_out, "grad_out", {coeffs.shape(2), height(), width()});
    }
};

py::object forward(const py::array& index, const py::array& weight, const std::optional<py::array>& faces,
                   const py::array& rays, const py::array& coeffs, int threads) {
    const Arguments arguments{index, weight, faces, rays, coeffs, threads};
    return with_type_of(coeffs, "coeffs", [&]<class T>() -> py::object {
        const Shading<T> shading = arguments.checked<T>();
        py::array_t<T> out({coeffs.shape(2), arguments.height(), arguments.width()});
        T* out_data = out.mutable_data();
        {
            py::gil_scoped_release release;
            shade(shading, out_data);
        }
        return out;
    });
}

py::object backward_coeffs(const py::array& grad_out, const py::array& index, const py::array& weight,
                           const std::optional<py::array>& faces, const py::array& rays,
                           const py::array& coeffs, int threads) {
    const Arguments arguments{index, weight, faces, rays, coeffs, threads};
    return with_type_of(coeffs, "coeffs", [&]<class T>() -> py::object {
        const Shading<T> shading = arguments.checked<T>();
        const T* grad_data = arguments.checked_grad<T>(grad_out);
        py::array_t<T> grad({coeffs.shape(0), coeffs.shape(1), coeffs.shape(2)});
        T* grad_coeffs = grad.mutable_data();
        {
            py::gil_scoped_release release;
            shade_backward_coeffs(shading, grad_data, grad_coeffs);
        }
        return grad;
    });
}

py::object backward_pixels(const py::array& grad_out, const py::array& index, const py::array& weight,
                           const std::optional<py::array>& faces, const py::array& rays,
                           const py::array& coeffs, int threads) {
    const Arguments arguments{index, weight, faces, rays, coeffs, threads};
    return with_type_of(coeffs, "coeffs", [&]<class T>() -> py::object {
        const Shading<T> shading = arguments.checked<T>();
        const T* grad_data = arguments.checked_grad<T>(grad_out);
        py::array_t<T> grad_weight({arguments.height(), arguments.width(), arguments.corners()});
        py::array_t<T> grad_rays({arguments.height(), arguments.width(), py::ssize_t{3}});
        T* grad_weight_data = grad_weight.mutable_data();
        T* grad_rays_data = grad_rays.mutable_data();
        {
            py::gil_scoped_release release;
            shade_backward_pixels(shading, grad_data, grad_weight_data, grad_rays_data);
        }
        return py::make_tuple(grad_weight, grad_rays);
    });
}

}  // namespace

void bind_shade(py::module_& m) {
    m.def("shade", &forward, py::arg("index"), py::arg("weight"), py::arg("faces").none(true),
          py::arg("rays"), py::arg("coeffs"), py::arg("threads"));
    m.def("shade_backward_coeffs", &backward_coeffs, py::arg("grad_out"), py::arg("index"), py::arg("weight"),
          py::arg("faces").none(true), py::arg("rays"), py::arg("coeffs"), py::arg("threads"));
    m.def("shade_backward_pixels", &backward_pixels, py::arg("grad_out"), py::arg("index"), py::arg("weight"),
          py::arg("faces").none(true), py::arg("rays"), py::arg("coeffs"), py::arg("threads"));
}

}  // namespace nmbg
