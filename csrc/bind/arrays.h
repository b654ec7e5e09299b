// NumPy arrays in and out of the kernels: checked, never copied or converted.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <string>

namespace nmbg {

namespace py = pybind11;

inline constexpr py::ssize_t any = -1;  // a size that is not prescribed

inline std::string shape_text(const py::ssize_t* sizes, py::ssize_t n) {
    std::string text = "[";
    for (py::ssize_t i = 0; i < n; ++i)
        text += (i ? ", " : "") + (sizes[i] == any ? std::string("*") : std::to_string(sizes[i]));
    return text + "]";
}

// The elements of a C-contiguous array of type T and of the shape given.
// Throws TypeError or ValueError that name the argument and say what came instead.
template <class T>
const T* elements(const py::array& array, const char* name, std::initializer_list<py::ssize_t> shape) {
    if (!py::isinstance<py::array_t<T>>(array))
        throw py::type_error(std::string(name) + ": expected " +
                             py::str(py::dtype::of<T>()).cast<std::string>() + ", got " +
                             py::str(array.dtype()).cast<std::string>());
    bool fits = array.ndim() == static_cast<py::ssize_t>(shape.size());
    for (py::ssize_t i = 0; fits && i < array.ndim(); ++i)
        fits = shape.begin()[i] == any || shape.begin()[i] == array.shape(i);
    if (!fits)
        throw py::value_error(std::string(name) + ": expected shape " +
                              shape_text(shape.begin(), static_cast<py::ssize_t>(shape.size())) + ", got " +
                              shape_text(array.shape(), array.ndim()));
    if (!(array.flags() & py::array::c_style))
        throw py::value_error(std::string(name) + ": expected C order");
    return static_cast<const T*>(array.data());
}

// Calls body.template operator()<T>() with the floating-point type of `array`.
template <class Body>
py::object with_type_of(const py::array& array, const char* name, const Body& body) {
    if (py::isinstance<py::array_t<float>>(array)) return body.template operator()<float>();
    if (py::isinstance<py::array_t<double>>(array)) return body.template operator()<double>();
    throw py::type_error(std::string(name) + ": expected float32 or float64, got " +
                         py::str(array.dtype()).cast<std::string>());
}

// A new array of zeros. The memory comes zeroed from the system: pages are touched where a kernel writes
// first.
template <class T>
py::array_t<T> zeros(std::initializer_list<py::ssize_t> shape) {
    py::tuple sizes(shape.size());
    for (std::size_t i = 0; i < shape.size(); ++i) sizes[i] = shape.begin()[i];
    return py::module_::import("numpy").attr("zeros")(sizes, py::dtype::of<T>());
}

inline void check_size(int64_t height, int64_t width) {
    if (height < 1 || width < 1 || height > std::numeric_limits<int32_t>::max() / width)
        throw py::value_error("expected an image of 1 to 2^31 - 1 pixels, got height " +
                              std::to_string(height) + " and width " + std::to_string(width));
}

inline void check_count(int64_t count, const char* name) {
    // Their elements are counted in 32 bits.
    if (count > std::numeric_limits<int32_t>::max() / 3)
        throw py::value_error(std::string(name) + ": expected at most (2^31 - 1) / 3 rows, got " +
                              std::to_string(count));
}

// More would all be images of one pixel.
inline void check_levels(int levels) {
    if (levels < 1 || levels > 32)
        throw py::value_error("levels: expected 1 to 32, got " + std::to_string(levels));
}

inline void check_threads(int threads) {
    if (threads < 1) throw py::value_error("threads: expected 1 or more, got " + std::to_string(threads));
}

}  // namespace nmbg
