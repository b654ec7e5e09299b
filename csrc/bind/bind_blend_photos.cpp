#include <cmath>
#include <string>
#include <vector>

#include "bind/arrays.h"
#include "core/blend_photos.h"

namespace nmbg {
namespace {

struct Rule {
    int keep;
    double angle, tolerance, border;

    template <class T>
    BlendRule<T> checked() const {
        if (keep < 1 || keep > most_sources)
            throw py::value_error("keep: expected 1 to " + std::to_string(most_sources) + ", got " +
                                  std::to_string(keep));
        for (const auto& [name, value] :
             {std::pair{"angle", angle}, {"tolerance", tolerance}, {"border", border}})
            if (!std::isfinite(value) || value <= 0)
                throw py::value_error(std::string(name) + ": expected a positive number, got " +
                                      std::to_string(value));
        return {keep, static_cast<T>(angle), static_cast<T>(tolerance), static_cast<T>(border)};
    }
};

// depth [H, W], warps [S, 3, 4], intrinsics [S, 3, 3], and per photo texels [mip_texels, 4] and depth [h, w]
struct Arguments {
    py::array depth, warps, intrinsics;
    double focal;
    std::vector<py::array> photos, photo_depths;
    Rule rule;
    int threads;

    py::ssize_t height() const { return depth.shape(0); }
    py::ssize_t width() const { return depth.shape(1); }
    py::ssize_t count() const { return static_cast<py::ssize_t>(photos.size()); }

    template <class T, class Texel>
    Blending<T, Texel> checked() const {
        check_threads(threads);
        Blending<T, Texel> blending{};
        blending.depth = elements<T>(depth, "depth", {any, any});
        check_size(height(), width());
        blending.height = static_cast<int32_t>(height());
        blending.width = static_cast<int32_t>(width());
        if (!std::isfinite(focal) || focal <= 0)
            throw py::value_error("focal: expected a positive number, got " + std::to_string(focal));
        blending.focal = static_cast<T>(focal);
        blending.rule = rule.checked<T>();
        blending.threads = threads;
        const T* warp = elements<T>(warps, "warps", {count(), 3, 4});
        const T* K = elements<T>(intrinsics, "intrinsics", {count(), 3, 3});
        if (photo_depths.size() != photos.size())
            throw py::value_error("photo_depths: expected " + std::to_string(photos.size()) +
                                  ", one a photo, got " + std::to_string(photo_depths.size()));
        for (std::size_t s = 0; s < photos.size(); ++s) {
            const py::array& surface = photo_depths[s];
            const T* depths = elements<T>(surface, "photo_depths", {any, any});
            check_size(surface.shape(0), surface.shape(1));
            const Texel* texels =
                elements<Texel>(photos[s], "photos", {mip_texels(surface.shape(0), surface.shape(1)), 4});
            blending.photos.push_back({texels, depths, static_cast<int32_t>(surface.shape(0)),
                                       static_cast<int32_t>(surface.shape(1)), warp + 12 * s, K + 9 * s});
        }
        return blending;
    }

    template <class T>
    BlendGradient<T> checked_gradient(const py::array& colour, const py::array& weight,
                                      const py::array& variance) const {
        return {elements<T>(colour, "grad_colour", {3, height(), width()}),
                elements<T>(weight, "grad_weight", {height(), width()}),
                elements<T>(variance, "grad_variance", {height(), width()})};
    }
};

// Calls body.template operator()<T, Texel>() with the types at hand; photos are all uint8 or all like
// `depth`.
template <class Body>
py::object with_types_of(const Arguments& arguments, const Body& body) {
    return with_type_of(arguments.depth, "depth", [&]<class T>() -> py::object {
        const bool bytes =
            !arguments.photos.empty() && py::isinstance<py::array_t<uint8_t>>(arguments.photos[0]);
        return bytes ? body.template operator()<T, uint8_t>() : body.template operator()<T, T>();
    });
}

Arguments arguments_of(const py::array& depth, const py::array& warps, const py::array& intrinsics,
                       double focal, const std::vector<py::array>& photos,
                       const std::vector<py::array>& photo_depths, int keep, double angle, double tolerance,
                       double border, int threads) {
    return {depth, warps, intrinsics, focal, photos, photo_depths, {keep, angle, tolerance, border}, threads};
}

// `each`: whether what the single sources show is wanted too; `which`: whether it is wanted which they are.
py::object forward(const Arguments& arguments, bool each, bool which) {
    return with_types_of(arguments, [&]<class T, class Texel>() -> py::object {
        const Blending<T, Texel> blending = arguments.checked<T, Texel>();
        const py::ssize_t H = arguments.height(), W = arguments.width(), keep = arguments.rule.keep;
        py::array_t<T> colour({py::ssize_t{3}, H, W}), weight({H, W}), variance({H, W}),
            weights({each ? keep : 0, H, W}), shown({each ? keep : 0, py::ssize_t{3}, H, W});
        py::array_t<int32_t> sources({H, W, which ? keep + 1 : 0});
        const BlendResult<T> out{colour.mutable_data(),
                                 weight.mutable_data(),
                                 variance.mutable_data(),
                                 which ? sources.mutable_data() : nullptr,
                                 each ? weights.mutable_data() : nullptr,
                                 each ? shown.mutable_data() : nullptr};
        {
            py::gil_scoped_release release;
            blend_photos(blending, out);
        }
        return py::make_tuple(colour, weight, variance, sources, weights, shown);
    });
}

py::object backward(const Arguments& arguments, const py::array& sources, const py::array& grad_colour,
                    const py::array& grad_weight, const py::array& grad_variance) {
    return with_types_of(arguments, [&]<class T, class Texel>() -> py::object {
        const Blending<T, Texel> blending = arguments.checked<T, Texel>();
        const BlendGradient<T> gradient =
            arguments.checked_gradient<T>(grad_colour, grad_weight, grad_variance);
        const py::ssize_t H = arguments.height(), W = arguments.width();
        const int32_t* chosen = elements<int32_t>(sources, "sources", {H, W, arguments.rule.keep + 1});
        py::array_t<T> grad_depth({H, W}), grad_warps({arguments.count(), py::ssize_t{3}, py::ssize_t{4}});
        T *depth_data = grad_depth.mutable_data(), *warps_data = grad_warps.mutable_data();
        {
            py::gil_scoped_release release;
            blend_photos_backward(blending, chosen, gradient, depth_data, warps_data);
        }
        return py::make_tuple(grad_depth, grad_warps);
    });
}

py::object backward_texels(const Arguments& arguments, const py::array& sources, const py::array& grad_colour,
                           const py::array& grad_weight, const py::array& grad_variance) {
    return with_type_of(arguments.depth, "depth", [&]<class T>() -> py::object {
        const Blending<T, T> blending = arguments.checked<T, T>();
        const BlendGradient<T> gradient =
            arguments.checked_gradient<T>(grad_colour, grad_weight, grad_variance);
        const int32_t* chosen = elements<int32_t>(
            sources, "sources", {arguments.height(), arguments.width(), arguments.rule.keep + 1});
        py::list grads;
        std::vector<T*> grads_data;
        for (const py::array& photo : arguments.photos) {
            py::array_t<T> grad = zeros<T>({photo.shape(0), photo.shape(1)});
            grads_data.push_back(grad.mutable_data());
            grads.append(grad);
        }
        {
            py::gil_scoped_release release;
            blend_photos_backward_texels(blending, chosen, gradient, grads_data);
        }
        return grads;
    });
}

}  // namespace

void bind_blend_photos(py::module_& m) {
    py::class_<Arguments>(m, "Blending")
        .def(py::init(&arguments_of), py::arg("depth"), py::arg("warps"), py::arg("intrinsics"),
             py::arg("focal"), py::arg("photos"), py::arg("photo_depths"), py::arg("keep"), py::arg("angle"),
             py::arg("tolerance"), py::arg("border"), py::arg("threads"))
        .def("forward", &forward, py::arg("each"), py::arg("which"))
        .def("backward", &backward, py::arg("sources"), py::arg("grad_colour"), py::arg("grad_weight"),
             py::arg("grad_variance"))
        .def("backward_texels", &backward_texels, py::arg("sources"), py::arg("grad_colour"),
             py::arg("grad_weight"), py::arg("grad_variance"));
}

}  // namespace nmbg
