// What the rasterizers are measured against: the loop that one would write first. No tiles, no lists, no
// vectors by hand; threads share the faces or points and merge their images in the end.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <omp.h>

namespace {

struct Vertex {
    float u, v, w;  // w = 1 / z, or 0 where the vertex is not drawn
};

std::vector<Vertex> project(const float* h, int64_t n, int threads) {
    std::vector<Vertex> out(n);
#pragma omp parallel for num_threads(threads)
    for (int64_t i = 0; i < n; ++i) {
        const float z = h[3 * i + 2], w = z > 0 ? 1 / z : 0;
        out[i] = {h[3 * i] * w, h[3 * i + 1] * w, w};
    }
    return out;
}

int32_t pixel_from(float x, int32_t size) {
    return static_cast<int32_t>(std::ceil(std::clamp(x - 0.5f, 0.0f, static_cast<float>(size))));
}

struct Seen {
    float w, b0, b1;
    int32_t item;
};

// The nearer of two; the first of equally near ones.
void merge(std::vector<std::vector<Seen>>& images, int64_t pixel) {
    for (std::size_t t = 1; t < images.size(); ++t)
        if (images[t][pixel].w > images[0][pixel].w) images[0][pixel] = images[t][pixel];
}

}  // namespace

extern "C" void plain_faces(const float* h, int64_t vertices, const int32_t* faces, int64_t count,
                            int32_t height, int32_t width, int threads, int32_t* face, float* depth,
                            float* bary) {
    const std::vector<Vertex> screen = project(h, vertices, threads);
    const int64_t pixels = int64_t{height} * width;
    std::vector<std::vector<Seen>> images(threads);
#pragma omp parallel num_threads(threads)
    {
        const int t = omp_get_thread_num();
        std::vector<Seen>& image = images[t];
        image.assign(pixels, {0, 0, 0, -1});
        for (int64_t f = count * t / threads; f < count * (t + 1) / threads; ++f) {
            const Vertex a = screen[faces[3 * f]], b = screen[faces[3 * f + 1]], c = screen[faces[3 * f + 2]];
            if (a.w <= 0 || b.w <= 0 || c.w <= 0) continue;
            const int32_t x0 = pixel_from(std::min({a.u, b.u, c.u}), width);
            const int32_t x1 = pixel_from(std::max({a.u, b.u, c.u}), width);
            const int32_t y0 = pixel_from(std::min({a.v, b.v, c.v}), height);
            const int32_t y1 = pixel_from(std::max({a.v, b.v, c.v}), height);
            if (x0 >= x1 || y0 >= y1) continue;
            const float area = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
            if (area == 0) continue;
            const float inverse = 1 / area;
            for (int32_t y = y0; y < y1; ++y)
                for (int32_t x = x0; x < x1; ++x) {
                    const float px = x + 0.5f, py = y + 0.5f;
                    const float e0 = ((b.u - px) * (c.v - py) - (b.v - py) * (c.u - px)) * inverse;
                    const float e1 = ((c.u - px) * (a.v - py) - (c.v - py) * (a.u - px)) * inverse;
                    const float e2 = 1 - e0 - e1;
                    if (e0 < 0 || e1 < 0 || e2 < 0) continue;
                    const float w = e0 * a.w + e1 * b.w + e2 * c.w;
                    Seen& seen = image[int64_t{y} * width + x];
                    if (w > seen.w) seen = {w, e0 * a.w / w, e1 * b.w / w, static_cast<int32_t>(f)};
                }
        }
#pragma omp barrier
#pragma omp for
        for (int64_t p = 0; p < pixels; ++p) {
            merge(images, p);
            const Seen& seen = images[0][p];
            face[p] = seen.item;
            depth[p] = seen.item < 0 ? 0 : 1 / seen.w;
            bary[3 * p] = seen.b0, bary[3 * p + 1] = seen.b1;
            bary[3 * p + 2] = seen.item < 0 ? 0 : 1 - seen.b0 - seen.b1;
        }
    }
}

extern "C" void plain_points(const float* h, int64_t points, float radius, int32_t height, int32_t width,
                             int threads, int32_t* index, float* dist2) {
    const int64_t pixels = int64_t{height} * width;
    std::vector<std::vector<Seen>> images(threads);
#pragma omp parallel num_threads(threads)
    {
        const int t = omp_get_thread_num();
        std::vector<Seen>& image = images[t];
        image.assign(pixels, {0, 0, 0, -1});
        for (int64_t i = points * t / threads; i < points * (t + 1) / threads; ++i) {
            const float z = h[3 * i + 2];
            if (z <= 0) continue;
            const float w = 1 / z, u = h[3 * i] * w, v = h[3 * i + 1] * w;
            const int32_t x0 = pixel_from(u - radius, width), x1 = pixel_from(u + radius, width);
            const int32_t y0 = pixel_from(v - radius, height), y1 = pixel_from(v + radius, height);
            for (int32_t y = y0; y < y1; ++y)
                for (int32_t x = x0; x < x1; ++x) {
                    const float dx = u - (x + 0.5f), dy = v - (y + 0.5f), d2 = dx * dx + dy * dy;
                    Seen& seen = image[int64_t{y} * width + x];
                    if (d2 < radius * radius && w > seen.w) seen = {w, d2, 0, static_cast<int32_t>(i)};
                }
        }
#pragma omp barrier
#pragma omp for
        for (int64_t p = 0; p < pixels; ++p) {
            merge(images, p);
            index[p] = images[0][p].item;
            dist2[p] = images[0][p].b0;
        }
    }
}
