#include "bind/arrays.h"
#include "core/rasterize_faces.h"

namespace nmbg {
namespace {

template <class T>
FacesView<T> faces_view(const py::array& h, const py::array& faces, int64_t height, int64_t width,
                        int threads) {
    check_size(height, width);
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
            threads};
}

py::object forward(const py::array& h, const py::array& faces, int64_t height, int64_t width, int threads) {
    return with_type_of(h, "h", [&]<class T>() -> py::object {
        const FacesView<T> view = faces_view<T>(h, faces, height, width, threads);
        py::array_t<int32_t> face({height, width});
        py::array_t<T> bary({height, width, int64_t{3}});
        int32_t* face_data = face.mutable_data();
        T* bary_data = bary.mutable_data();
        {
            py::gil_scoped_release release;
            rasterize_faces(view, face_data, bary_data);
        }
        return py::make_tuple(face, bary);
    });
}

py::object backward(const py::array& h, const py::array& faces, const py::array& face,
                    const py::array& grad_bary, int threads) {
    return with_type_of(h, "h", [&]<class T>() -> py::object {
        const int32_t* face_data = elements<int32_t>(face, "face", {any, any});
        const T* grad_data = elements<T>(grad_bary, "grad_bary", {face.shape(0), face.shape(1), 3});
        const FacesView<T> view = faces_view<T>(h, faces, face.shape(0), face.shape(1), threads);
        py::array_t<T> grad_h = zeros<T>({view.vertices, 3});
        T* grad_h_data = grad_h.mutable_data();
        {
            py::gil_scoped_release release;
            rasterize_faces_backward(view, face_data, grad_data, grad_h_data);
        }
        return grad_h;
    });
}

}  // namespace

void bind_rasterize_faces(py::module_& m) {
    m.def("rasterize_faces", &forward, py::arg("h"), py::arg("faces"), py::arg("height"), py::arg("width"),
          py::arg("threads"));
    m.def("rasterize_faces_backward", &backward, py::arg("h"), py::arg("faces"), py::arg("face"),
          py::arg("grad_bary"), py::arg("threads"));
}

}  // namespace nmbg
