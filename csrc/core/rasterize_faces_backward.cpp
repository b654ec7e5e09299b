#include <array>

#include "core/check.h"
#include "core/pyramid.h"
#include "core/rasterize_faces.h"
#include "core/scatter.h"
#include "core/triangle.h"

namespace nmbg {

template <class T>
void rasterize_faces_backward(const FacesView<T>& view, const int32_t* face, const T* grad_bary,
                              const T* grad_depth, T* grad_h) {
    const Pyramid pyramid(view.height, view.width, view.levels);
    for (const Level& level : pyramid.levels()) {
        const auto corners = [&](int64_t pixel, std::array<int32_t, 3>& vertex) {
            const int32_t f = checked("face", face[level.first_pixel + pixel], -1, view.count);
            if (f < 0) return false;
            for (int k = 0; k < 3; ++k)
                vertex[k] = checked("faces", view.faces[3 * int64_t{f} + k], 0, view.vertices);
            return true;
        };
        const auto add = [&](int64_t pixel, int k, int32_t vertex) {
            const int64_t at = level.first_pixel + pixel;
            const Corners<double> h = corners_of(view, level.scale, face[at]);
            const Triangle<double> triangle(h);
            const Vec3<double> p{pixel % level.width + 0.5, pixel / level.width + 0.5, 1};

            // b_i = e_i / Σ e and depth = Σ b_i z_i, hence dL/de_i = (g_i - Σ g b) / Σ e with g_i the
            // gradient of b_i, to which the depth adds z_i times its own.
            std::array<double, 3> e, g;
            double sum = 0, weighted = 0;
            for (int i = 0; i < 3; ++i) {
                e[i] = triangle.edge(i, p.x, p.y);
                g[i] = grad_bary[3 * at + i] + grad_depth[at] * h[i].z;
                sum += e[i], weighted += g[i] * e[i];
            }
            const double mean = weighted / sum;
            const auto grad_edge = [&](int i) { return triangle.orientation * (g[i] - mean) / sum; };

            // With next and last the corners after k: e_next = p · (last × h_k), e_last = p · (h_k × next).
            const int next = (k + 1) % 3, last = (k + 2) % 3;
            const Vec3<double> through_next = cross(p, h[last]), through_last = cross(h[next], p);
            const double gn = grad_edge(next), gl = grad_edge(last);
            T* grad = grad_h + 3 * int64_t{vertex};
            grad[0] += static_cast<T>(level.scale * (gn * through_next.x + gl * through_last.x));
            grad[1] += static_cast<T>(level.scale * (gn * through_next.y + gl * through_last.y));
            grad[2] +=
                static_cast<T>(gn * through_next.z + gl * through_last.z + grad_depth[at] * e[k] / sum);
        };
        ordered_scatter<3>(int64_t{level.height} * level.width, view.vertices, view.threads, corners, add);
    }
}

template void rasterize_faces_backward(const FacesView<float>&, const int32_t*, const float*, const float*,
                                       float*);
template void rasterize_faces_backward(const FacesView<double>&, const int32_t*, const double*, const double*,
                                       double*);

}  // namespace nmbg
