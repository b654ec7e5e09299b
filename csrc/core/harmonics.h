// Real spherical harmonics of degree 0, 1 and 2 as polynomials of a unit direction.
#pragma once

namespace nmbg {

namespace sh {
constexpr double c0 = 0.28209479177387814;   // √(1/4π)
constexpr double c1 = 0.48860251190291992;   // √(3/4π)
constexpr double c2 = 1.0925484305920792;    // √(15/4π)
constexpr double c20 = 0.31539156525252005;  // √(5/16π)
constexpr double c22 = 0.54627421529603959;  // √(15/16π)
}  // namespace sh

// The first B = 1, 4 or 9 functions at direction d [3].
template <int B, class T>
inline void harmonics(const T* d, T* Y) {
    static_assert(B == 1 || B == 4 || B == 9);
    Y[0] = T(sh::c0);
    if constexpr (B >= 4) {
        const T x = d[0], y = d[1], z = d[2];
        Y[1] = -T(sh::c1) * y;
        Y[2] = T(sh::c1) * z;
        Y[3] = -T(sh::c1) * x;
        if constexpr (B >= 9) {
            Y[4] = T(sh::c2) * x * y;
            Y[5] = -T(sh::c2) * y * z;
            Y[6] = T(sh::c20) * (2 * z * z - x * x - y * y);
            Y[7] = -T(sh::c2) * x * z;
            Y[8] = T(sh::c22) * (x * x - y * y);
        }
    }
}

// Gradient of Σ_b g_b Y_b(d) with respect to d [3], of the polynomials as they are written above.
template <int B, class T>
inline void harmonics_backward(const T* d, const T* g, T* grad) {
    grad[0] = grad[1] = grad[2] = 0;
    if constexpr (B >= 4) {
        const T x = d[0], y = d[1], z = d[2];
        grad[0] -= T(sh::c1) * g[3];
        grad[1] -= T(sh::c1) * g[1];
        grad[2] += T(sh::c1) * g[2];
        if constexpr (B >= 9) {
            grad[0] +=
                T(sh::c2) * (y * g[4] - z * g[7]) - 2 * T(sh::c20) * x * g[6] + 2 * T(sh::c22) * x * g[8];
            grad[1] +=
                T(sh::c2) * (x * g[4] - z * g[5]) - 2 * T(sh::c20) * y * g[6] - 2 * T(sh::c22) * y * g[8];
            grad[2] += 4 * T(sh::c20) * z * g[6] - T(sh::c2) * (y * g[5] + x * g[7]);
        }
    }
}

}  // namespace nmbg
