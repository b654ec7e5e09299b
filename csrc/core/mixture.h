// What the sources of pixels give together: their weights, and the sums over them.
#pragma once

#include "core/blend_photos.h"
#include "core/vectors.h"

namespace nmbg {

// Share of their own score that sources keep when the next one is as good: all equal, all count the same.
constexpr double least_share = 1e-4;

// N pixels at once. Sources stand from the best score down; one that is not there has score 0 and colour 0.
template <class T, int N>
struct Mixture {
    // Given.
    T score[most_sources + 1][N];  // the one after the last that is blended sets the weights
    T shown[most_sources][3][N];
    // Computed by mix().
    T weight[most_sources][N], total[N];  // normalised; the sum before that
    T colour[3][N], variance[N];
    T deviation[most_sources][N];  // squared distance of a source's colour from the mean

    NMBG_INLINE void mix(int keep) {
        clear(total), clear(variance);
        for (int c = 0; c < 3; ++c) clear(colour[c]);
        for (int k = 0; k < keep; ++k)
#pragma omp simd
            for (int i = 0; i < N; ++i) {
                const T excess = score[k][i] - T(1 - least_share) * score[keep][i];
                weight[k][i] = excess > 0 ? excess : T(0);
                total[i] += weight[k][i];
            }
        for (int k = 0; k < keep; ++k)
#pragma omp simd
            for (int i = 0; i < N; ++i) {
                weight[k][i] /= total[i] > 0 ? total[i] : T(1);
                for (int c = 0; c < 3; ++c) colour[c][i] += weight[k][i] * shown[k][c][i];
            }
        for (int k = 0; k < keep; ++k)
#pragma omp simd
            for (int i = 0; i < N; ++i) {
                const T red = shown[k][0][i] - colour[0][i], green = shown[k][1][i] - colour[1][i],
                        blue = shown[k][2][i] - colour[2][i];
                deviation[k][i] = (red * red + green * green + blue * blue) * T(1.0 / 3);
                variance[i] += weight[k][i] * deviation[k][i];
            }
    }

  private:
    NMBG_INLINE static void clear(T (&values)[N]) {
        for (int i = 0; i < N; ++i) values[i] = 0;
    }
};

}  // namespace nmbg
