#include "bind/arrays.h"
#include "core/pyramid.h"
#include "core/rasterize_faces.h"

namespace nmbg {
namespace {

template <class T>
FacesView<T> faces_view(const py::array& h, const py::array& faces, int64_t height, int64_t width, int levels,
                        int threads) {
    check_size(height, width);
    check_levels(levels);
    check_threads(threads);
    const T* h_data = elements<T>(h, "h", {any, 3});
    const int32_t* faces_data = elements<int32_t>(faces, "faces", {any, 3});
    check_count(h.shape(0), "h");
    check_count(faces.shape(0), "faces");
    return {h_data,
            faces_data,
            h.shape(0),
            faces.shape(0),
            static_cast<int32_t>(height),
            static_cast<int32_t>(width),
            levels,
            threads};
}

py::object forward(const py::array& h, const py::array& faces, int64_t height, int64_t width, int levels,
                   int threads) {
    return with_type_of(h, "h", [&]<class T>() -> py::object {
        const FacesView<T> view = faces_view<T>(h, faces, height, width, levels, threads);
        const int64_t pixels = Pyramid(view.height, view.width, levels).pixels();
        py::array_t<int32_t> face(pixels);
        py::array_t<T> bary({pixels, int64_t{3}}), depth(pixels);
        const FacesResult<T> out{face.mutable_data(), bary.mutable_data(), depth.mutable_data()};
        {
            py::gil_scoped_release release;
            rasterize_faces(view, out);
        }
        return py::make_tuple(face, bary, depth);
    });
}

py::object backward(const py::array& h, const py::array& faces, int64_t height, int64_t width, int levels,
                    const py::array& face, const py::array& grad_bary, const py::array& grad_depth,
                    int threads) {
    return with_type_of(h, "h", [&]<class T>() -> py::object {
        const FacesView<T> view = faces_view<T>(h, faces, height, width, levels, threads);
        const int64_t pixels = Pyramid(view.height, view.width, levels).pixels();
        const int32_t* face_data = elements<int32_t>(face, "face", {pixels});
        const T* grad_bary_data = elements<T>(grad_bary, "grad_bary", {pixels, 3});
        const T* grad_depth_data = elements<T>(grad_depth, "grad_depth", {pixels});
        py::array_t<T> grad_h = zeros<T>({view.vertices, 3});
        T* grad_h_data = grad_h.mutable_data();
        {
            py::gil_scoped_release release;
            rasterize_faces_backward(view, face_data, grad_bary_data, grad_depth_data, grad_h_data);
        }
        return grad_h;
    });
}

}  // namespace

void bind_rasterize_faces(py::module_& m) {
    m.def("rasterize_faces", &forward, py::arg("h"), py::arg("faces"), py::arg("height"), py::arg("width"),
          py::arg("levels"), py::arg("threads"));
    m.def("rasterize_faces_backward", &backward, py::arg("h"), py::arg("faces"), py::arg("height"),
          py::arg("width"), py::arg("levels"), py::arg("face"), py::arg("grad_bary"), py::arg("grad_depth"),
          py::arg("threads"));
}

}  // namespace nmbg
