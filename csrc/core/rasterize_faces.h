// Triangles in homogeneous pixels; the nearest one along the ray through each pixel centre wins.
#pragma once

#include <cstdint>

namespace nmbg {

// The problem. T is float or double; edges, depths and barycentrics are computed in double.
template <class T>
struct FacesView {
    const T* h;            // [vertices, 3] homogeneous pixels (u z, v z, z) of the finest level
    const int32_t* faces;  // [count, 3] vertices of each face
    int64_t vertices;
    int64_t count;          // of faces
    int32_t height, width;  // of the finest level
    int levels;             // of the pyramid (see Pyramid)
    int threads;
};

// What the pixels of all levels see, level after level.
template <class T>
struct FacesResult {
    int32_t* face;  // [pixels] the face, or -1
    T* bary;        // [pixels, 3] perspective-correct barycentrics, or 0
    T* depth;       // [pixels] view-space z, or 0
};

// h, faces → boxes of pixels → lists of faces per tile → per tile, nearer ones first: test the three edges,
// keep the nearest z, of equal ones the lowest face. Homogeneous edges (Olano and Greer, "Triangle scan
// conversion using 2D homogeneous coordinates", 1997) need no clipping: the part of a face in front of the
// camera is drawn. Throws std::invalid_argument where a face names a vertex that is not there.
template <class T>
void rasterize_faces(const FacesView<T>& view, const FacesResult<T>& out);

// Gradient of bary and depth with respect to h.
//   face [pixels], grad_bary [pixels, 3], grad_depth [pixels] → grad_h [vertices, 3], which comes zeroed
template <class T>
void rasterize_faces_backward(const FacesView<T>& view, const int32_t* face, const T* grad_bary,
                              const T* grad_depth, T* grad_h);

}  // namespace nmbg
