"""Types of the compiled kernels; nmbg.ops is their public face."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

_Float = npt.NDArray[np.floating]
_Int = npt.NDArray[np.int32]

version: str
openmp: bool
simd: str

def project(P: _Float, points: _Float, threads: int) -> _Float: ...
def rays(M: _Float, height: int, width: int, single: bool, threads: int) -> _Float: ...
def rasterize_points(
    h: _Float, radius_px: float, height: int, width: int, levels: int, threads: int
) -> tuple[_Int, _Float]: ...
def rasterize_points_backward(
    h: _Float,
    radius_px: float,
    height: int,
    width: int,
    levels: int,
    index: _Int,
    grad_dist2: _Float,
    threads: int,
) -> _Float: ...
def rasterize_faces(
    h: _Float, faces: _Int, height: int, width: int, levels: int, threads: int
) -> tuple[_Int, _Float, _Float]: ...
def rasterize_faces_backward(
    h: _Float,
    faces: _Int,
    height: int,
    width: int,
    levels: int,
    face: _Int,
    grad_bary: _Float,
    grad_depth: _Float,
    threads: int,
) -> _Float: ...
def shade(
    index: _Int, weight: _Float, faces: _Int | None, rays: _Float, coeffs: _Float, threads: int
) -> _Float: ...
def shade_backward_coeffs(
    grad_out: _Float,
    index: _Int,
    weight: _Float,
    faces: _Int | None,
    rays: _Float,
    coeffs: _Float,
    threads: int,
) -> _Float: ...
def shade_backward_pixels(
    grad_out: _Float,
    index: _Int,
    weight: _Float,
    faces: _Int | None,
    rays: _Float,
    coeffs: _Float,
    threads: int,
) -> tuple[_Float, _Float]: ...
def adam_rows(
    table: _Float,
    mean: _Float,
    square: _Float,
    index: npt.NDArray[np.int64],
    grad: _Float,
    rate: float,
    beta1: float,
    beta2: float,
    eps: float,
    threads: int,
) -> None: ...
def gate(x: _Float, out: _Float, threads: int) -> None: ...
def gate_backward(x: _Float, grad_out: _Float, grad: _Float, threads: int) -> None: ...

class Blending:
    def __init__(
        self,
        depth: _Float,
        warps: _Float,
        intrinsics: _Float,
        focal: float,
        photos: Sequence[npt.NDArray[np.generic]],
        photo_depths: Sequence[_Float],
        keep: int,
        angle: float,
        tolerance: float,
        border: float,
        threads: int,
    ) -> None: ...
    def forward(self, each: bool, which: bool) -> tuple[_Float, _Float, _Float, _Int, _Float, _Float]: ...
    def backward(
        self, sources: _Int, grad_colour: _Float, grad_weight: _Float, grad_variance: _Float
    ) -> tuple[_Float, _Float]: ...
    def backward_texels(
        self, sources: _Int, grad_colour: _Float, grad_weight: _Float, grad_variance: _Float
    ) -> list[_Float]: ...
