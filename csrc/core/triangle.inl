// Edges of triangles in homogeneous pixels, one or eight at a time. Read once per instruction set
// (each_isa.h).

namespace nmbg::NMBG_ISA {

template <class S>
struct Vec3 {
    S x, y, z;
};

// Of eight faces, one after another, the rows of h [vertices, 3] that their k-th corners name; `vertex`
// points to the k-th corner of the first.
template <class T>
NMBG_INLINE Vec3<eight<T>> load_corners(const T* h, const int32_t* vertex) {
#ifdef NMBG_AVX2
    if constexpr (std::is_same_v<T, float>) {
        const auto row = [&](int i) NMBG_INLINE_LAMBDA {
            const float* from = h + 3 * int64_t{vertex[3 * i]};
#ifdef NMBG_AVX512
            return _mm_maskz_loadu_ps(7, from);
#else
            return _mm_maskload_ps(from, _mm_set_epi32(0, -1, -1, -1));
#endif
        };
        const auto rows = [&](int i) NMBG_INLINE_LAMBDA {
            return (f32x8)_mm256_insertf128_ps(_mm256_castps128_ps256(row(i)), row(i + 4), 1);
        };
        const f32x8 a = rows(0), b = rows(1), c = rows(2), d = rows(3);
        const f32x8 ab = __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13);
        const f32x8 cd = __builtin_shufflevector(c, d, 0, 8, 1, 9, 4, 12, 5, 13);
        const f32x8 ab_z = __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15);
        const f32x8 cd_z = __builtin_shufflevector(c, d, 2, 10, 3, 11, 6, 14, 7, 15);
        return {__builtin_shufflevector(ab, cd, 0, 1, 8, 9, 4, 5, 12, 13),
                __builtin_shufflevector(ab, cd, 2, 3, 10, 11, 6, 7, 14, 15),
                __builtin_shufflevector(ab_z, cd_z, 0, 1, 8, 9, 4, 5, 12, 13)};
    }
#endif
    Vec3<eight<T>> at;
    for (int i = 0; i < wide; ++i) {
        const T* from = h + 3 * int64_t{vertex[3 * i]};
        at.x[i] = from[0], at.y[i] = from[1], at.z[i] = from[2];
    }
    return at;
}

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
