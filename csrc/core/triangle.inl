// Edges of triangles in homogeneous pixels, one or eight at a time. Read once per instruction set
// (each_isa.h).

namespace nmbg::NMBG_ISA {

template <class S>
struct Vec3 {
    S x, y, z;
};

// Exact antisymmetry, cross(a, b) == -cross(b, a) to the last bit, is what makes two faces agree on the edge
// between them: every pixel centre is on the inner side of exactly one of the two.
template <class S>
NMBG_INLINE Vec3<S> cross(const Vec3<S>& a, const Vec3<S>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <class S>
NMBG_INLINE S dot(const Vec3<S>& a, const Vec3<S>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

template <class S>
struct Corners {
    Vec3<S> at[3];

    NMBG_INLINE const Vec3<S>& operator[](int k) const { return at[k]; }
};

// The lines opposite to the corners, positive on the side of the face, and where its surface stands. S is a
// double, or several.
//   edge k at pixel centre (x, y): a[k] x + (b[k] y + c[k]), monotonic in x and in y even after rounding, so
//   that the extreme over a box of pixels is at one of its corners
//   view-space z: determinant / Σ edges
template <class S>
struct Triangle {
    S a[3], b[3], c[3];
    S least[3];     // an edge's least value inside
    S determinant;  // of the corners, >= 0: 0 for a face without area
    S orientation;  // +1 or -1, the sign taken out of the determinant and the edges

    NMBG_INLINE explicit Triangle(const Corners<S>& h) {
        const Vec3<S> lines[3] = {cross(h[1], h[2]), cross(h[2], h[0]), cross(h[0], h[1])};
        const S zero = splat<S>(0), smallest = splat<S>(std::numeric_limits<double>::denorm_min());
        const S signed_determinant = dot(h[0], lines[0]);
        orientation = select(signed_determinant < zero, splat<S>(-1), splat<S>(1));
        determinant = orientation * signed_determinant;
        for (int k = 0; k < 3; ++k) {
            a[k] = orientation * lines[k].x, b[k] = orientation * lines[k].y, c[k] = orientation * lines[k].z;
            // On the line, decide as if the pixel centre were moved by (ε, ε²): the same shift for all faces,
            // hence no pixel is lost or owned twice, at edges and at vertices.
            const auto owns = (a[k] > zero) | ((a[k] == zero) & (b[k] > zero));
            least[k] = select(owns, zero, smallest);
        }
    }

    NMBG_INLINE auto drawable() const {
        return (determinant > splat<S>(0)) & (determinant <= splat<S>(std::numeric_limits<double>::max()));
    }

    NMBG_INLINE S edge(int k, const S& x, const S& y) const { return a[k] * x + (b[k] * y + c[k]); }
};

}  // namespace nmbg::NMBG_ISA
