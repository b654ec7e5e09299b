#include "core/rasterize_faces.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "core/bins.h"
#include "core/check.h"
#include "core/parallel.h"
#include "core/scatter.h"
#include "core/tiles.h"

namespace nmbg {
namespace {

struct Vec3 {
    double x, y, z;
};

// Exact antisymmetry, cross(a, b) == -cross(b, a) to the last bit, is what makes two faces agree on the edge
// between them: every pixel centre is on the inner side of exactly one of the two.
Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

double dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

using Corners = std::array<Vec3, 3>;

template <class T>
Corners corners_of(const FacesView<T>& view, int64_t face) {
    Corners corners;
    for (int k = 0; k < 3; ++k) {
        const int32_t vertex = checked("faces", view.faces[3 * face + k], 0, view.vertices);
        const T* h = view.h + 3 * int64_t{vertex};
        corners[k] = {h[0], h[1], h[2]};
    }
    return corners;
}

bool finite(const Vec3& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

// Where the face leaves towards the camera plane along the edge from `front` (z > 0) to `back` (z <= 0), its
// projection runs to infinity: the sign of the direction along x or y, 0 if it stays at the front's
// coordinate.
int direction_to_infinity(double front, double front_z, double back, double back_z) {
    const double a = front_z * back, b = back_z * front;
    return (a > b) - (a < b);
}

// Every pixel that a face may cover; empty for a face that is not drawn.
PixelBox reach(const Corners& corners, int32_t width, int32_t height) {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    double xmin = infinity, ymin = infinity, xmax = -infinity, ymax = -infinity;
    for (int k = 0; k < 3; ++k) {
        const Vec3& front = corners[k];
        if (!finite(front)) return {};
        if (front.z <= 0) continue;
        const double u = front.x / front.z, v = front.y / front.z;
        xmin = std::min(xmin, u), xmax = std::max(xmax, u);
        ymin = std::min(ymin, v), ymax = std::max(ymax, v);
        for (int other = 1; other < 3; ++other) {
            const Vec3& back = corners[(k + other) % 3];
            if (back.z > 0) continue;
            const int dx = direction_to_infinity(front.x, front.z, back.x, back.z);
            const int dy = direction_to_infinity(front.y, front.z, back.y, back.z);
            if (dx < 0) xmin = -infinity;
            if (dx > 0) xmax = infinity;
            if (dy < 0) ymin = -infinity;
            if (dy > 0) ymax = infinity;
        }
    }
    if (!(xmin <= xmax && ymin <= ymax)) return {};
    return pixels_within(xmin, ymin, xmax, ymax, width, height);
}

// The line opposite to a corner, positive on the side of the face. The value at (x, y) is monotonic in x and
// in y even after rounding, so that the extreme over a box of pixels is at one of its corners.
struct Edge {
    double a, b, c;
    bool owns;  // whether a pixel centre exactly on the line counts as inside

    double at_row(double y) const { return b * y + c; }
    bool inside(double value) const { return value > 0 || (value == 0 && owns); }
};

struct Triangle {
    std::array<Edge, 3> edges;
    double determinant;  // of the corners, >= 0: 0 for a face without area
    double orientation;  // +1 or -1, the sign taken out of the determinant and the edges

    explicit Triangle(const Corners& h) {
        std::array<Vec3, 3> lines;
        for (int k = 0; k < 3; ++k) lines[k] = cross(h[(k + 1) % 3], h[(k + 2) % 3]);
        const double signed_determinant = dot(h[0], lines[0]);
        orientation = signed_determinant < 0 ? -1 : 1;
        determinant = std::abs(signed_determinant);
        for (int k = 0; k < 3; ++k) {
            const double a = orientation * lines[k].x, b = orientation * lines[k].y,
                         c = orientation * lines[k].z;
            // On the line, decide as if the pixel centre were moved by (ε, ε²): the same shift for all faces,
            // hence no pixel is lost or owned twice, at edges and at vertices.
            edges[k] = {a, b, c, a > 0 || (a == 0 && b > 0)};
        }
    }

    bool drawable() const { return determinant > 0 && std::isfinite(determinant); }

    // False only when no pixel centre of the box is inside.
    bool may_cover(const PixelBox& box) const {
        for (const Edge& edge : edges) {
            const double x = (edge.a > 0 ? box.x1 - 1 : box.x0) + 0.5;
            const double y = (edge.b > 0 ? box.y1 - 1 : box.y0) + 0.5;
            if (edge.a * x + edge.at_row(y) < 0) return false;
        }
        return true;
    }
};

}  // namespace

template <class T>
void rasterize_faces(const FacesView<T>& view, int32_t* face, T* bary) {
    const Tiling tiling(view.height, view.width);

    std::vector<PixelBox> boxes(view.count);
    parallel_blocks(view.count, view.threads, [&](int64_t begin, int64_t end) {
        for (int64_t f = begin; f < end; ++f) boxes[f] = reach(corners_of(view, f), view.width, view.height);
    });

    // Large faces are tested against each tile: a box alone would list them in many that they do not touch.
    const Bins<int32_t> bins(view.count, tiling.count(), view.threads, [&](int64_t f, const auto& put) {
        const PixelBox& box = boxes[f];
        const auto item = static_cast<int32_t>(f);
        if (box.empty()) return;
        if (tiling.within_one(box)) {
            put(tiling.of(box.x0, box.y0), item);
            return;
        }
        const Triangle triangle(corners_of(view, f));
        tiling.for_each(box, [&](int64_t tile) {
            if (triangle.may_cover(tiling.box(tile).intersected(box))) put(tile, item);
        });
    });

    parallel_for(tiling.count(), view.threads, [&](int64_t t) {
        const PixelBox tile = tiling.box(t);
        std::array<double, Tiling::pixels> nearest;
        nearest.fill(std::numeric_limits<double>::infinity());
        for (int32_t y = tile.y0; y < tile.y1; ++y) {
            const int64_t row = int64_t{y} * view.width;
            std::fill(face + row + tile.x0, face + row + tile.x1, -1);
            std::fill(bary + 3 * (row + tile.x0), bary + 3 * (row + tile.x1), T(0));
        }

        for (const int32_t f : bins[t]) {
            const Triangle triangle(corners_of(view, f));
            if (!triangle.drawable()) continue;
            const auto& [e0, e1, e2] = triangle.edges;
            const PixelBox box = boxes[f].intersected(tile);
            for (int32_t y = box.y0; y < box.y1; ++y) {
                const double row0 = e0.at_row(y + 0.5), row1 = e1.at_row(y + 0.5), row2 = e2.at_row(y + 0.5);
                for (int32_t x = box.x0; x < box.x1; ++x) {
                    const double b0 = e0.a * (x + 0.5) + row0;
                    const double b1 = e1.a * (x + 0.5) + row1;
                    const double b2 = e2.a * (x + 0.5) + row2;
                    if (!e0.inside(b0) || !e1.inside(b1) || !e2.inside(b2)) continue;
                    const double sum = b0 + b1 + b2;
                    const double depth = triangle.determinant / sum;
                    double& winner = nearest[tiling.slot(tile, x, y)];
                    if (!(depth < winner)) continue;
                    winner = depth;
                    const int64_t pixel = int64_t{y} * view.width + x;
                    face[pixel] = f;
                    bary[3 * pixel] = static_cast<T>(b0 / sum);
                    bary[3 * pixel + 1] = static_cast<T>(b1 / sum);
                    bary[3 * pixel + 2] = static_cast<T>(b2 / sum);
                }
            }
        }
    });
}

template <class T>
void rasterize_faces_backward(const FacesView<T>& view, const int32_t* face, const T* grad_bary, T* grad_h) {
    const int64_t pixels = int64_t{view.height} * view.width;
    const auto corners = [&](int64_t pixel, std::array<int32_t, 3>& vertex) {
        const int32_t f = checked("face", face[pixel], -1, view.count);
        if (f < 0) return false;
        for (int k = 0; k < 3; ++k)
            vertex[k] = checked("faces", view.faces[3 * int64_t{f} + k], 0, view.vertices);
        return true;
    };
    ordered_scatter<3>(
        pixels, view.vertices, view.threads, corners, [&](int64_t pixel, int k, int32_t vertex) {
            const Corners h = corners_of(view, face[pixel]);
            const Triangle triangle(h);
            const Vec3 p{pixel % view.width + 0.5, pixel / view.width + 0.5, 1};

            // b_i = e_i / Σ e, hence dL/de_i = (g_i - Σ g b) / Σ e.
            std::array<double, 3> e;
            for (int i = 0; i < 3; ++i) e[i] = triangle.edges[i].a * p.x + triangle.edges[i].at_row(p.y);
            const double sum = e[0] + e[1] + e[2];
            const T* g = grad_bary + 3 * pixel;
            const double mean = (g[0] * e[0] + g[1] * e[1] + g[2] * e[2]) / sum;
            const auto grad_edge = [&](int i) { return triangle.orientation * (g[i] - mean) / sum; };

            // With next and last the corners after k: e_next = p · (last × h_k), e_last = p · (h_k × next).
            const int next = (k + 1) % 3, last = (k + 2) % 3;
            const Vec3 through_next = cross(p, h[last]), through_last = cross(h[next], p);
            const double gn = grad_edge(next), gl = grad_edge(last);
            T* grad = grad_h + 3 * int64_t{vertex};
            grad[0] += static_cast<T>(gn * through_next.x + gl * through_last.x);
            grad[1] += static_cast<T>(gn * through_next.y + gl * through_last.y);
            grad[2] += static_cast<T>(gn * through_next.z + gl * through_last.z);
        });
}

template void rasterize_faces(const FacesView<float>&, int32_t*, float*);
template void rasterize_faces(const FacesView<double>&, int32_t*, double*);
template void rasterize_faces_backward(const FacesView<float>&, const int32_t*, const float*, float*);
template void rasterize_faces_backward(const FacesView<double>&, const int32_t*, const double*, double*);

}  // namespace nmbg
