// Triangles in homogeneous pixels; the nearest one along the ray through each pixel centre wins.
#pragma once

#include <cstdint>

namespace nmbg {

// The problem. T is float or double; edges, depths and barycentrics are computed in double.
template <class T>
struct FacesView {
    const T* h;            // [vertices, 3] homogeneous pixels (u z, v z, z)
    const int32_t* faces;  // [count, 3] vertices of each face
    int64_t vertices;
    int64_t count;          // of faces
    int32_t height, width;  // of the image
    int threads;
};

// h, faces → boxes of pixels and the tiles they touch → per tile, in ascending order of face: test the
// three edges, keep the nearest z. Homogeneous edges (Olano and Greer, "Triangle scan conversion using 2D
// homogeneous coordinates", 1997) need no clipping: the part of a face in front of the camera is drawn.
//   face [height, width]: the face, or -1
//   bary [height, width, 3]: perspective-correct barycentrics, or 0
// Throws std::invalid_argument where a face names a vertex that is not there.
template <class T>
void rasterize_faces(const FacesView<T>& view, int32_t* face, T* bary);

// Gradient of bary with respect to h.
//   face [height, width], grad_bary [height, width, 3] → grad_h [vertices, 3]
template <class T>
void rasterize_faces_backward(const FacesView<T>& view, const int32_t* face, const T* grad_bary, T* grad_h);

}  // namespace nmbg
