"""Rasterization of points and faces: which of them each pixel sees."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
from torch import Tensor

from nmbg import _core
from nmbg.ops._arrays import array

# The ops return values before indices: torch.library.opcheck sums outputs into the first one.


@torch.library.custom_op("nmbg::rasterize_points", mutates_args=(), device_types="cpu")
def _rasterize_points(
    h: Tensor, radius_px: float, height: int, width: int, levels: int
) -> tuple[Tensor, Tensor]:
    index, dist2 = _core.rasterize_points(
        array("h", h), radius_px, height, width, levels, torch.get_num_threads()
    )
    return torch.from_numpy(dist2), torch.from_numpy(index)


@_rasterize_points.register_fake
def _(h: Tensor, radius_px: float, height: int, width: int, levels: int) -> tuple[Tensor, Tensor]:
    pixels = sum(rows * columns for rows, columns in _sizes(height, width, levels))
    return h.new_empty(pixels), h.new_empty(pixels, dtype=torch.int32)


@torch.library.custom_op("nmbg::rasterize_points_backward", mutates_args=(), device_types="cpu")
def _rasterize_points_backward(
    h: Tensor, radius_px: float, height: int, width: int, levels: int, index: Tensor, grad_dist2: Tensor
) -> Tensor:
    return torch.from_numpy(
        _core.rasterize_points_backward(
            array("h", h),
            radius_px,
            height,
            width,
            levels,
            array("index", index),
            array("grad_dist2", grad_dist2),
            torch.get_num_threads(),
        )
    )


@_rasterize_points_backward.register_fake
def _(
    h: Tensor, radius_px: float, height: int, width: int, levels: int, index: Tensor, grad_dist2: Tensor
) -> Tensor:
    return h.new_empty(h.shape)


def _save_points(
    ctx: Any, inputs: tuple[Tensor, float, int, int, int], output: tuple[Tensor, Tensor]
) -> None:
    h, *ctx.drawing = inputs
    _, index = output
    ctx.mark_non_differentiable(index)
    ctx.save_for_backward(h, index)


def _grad_points(ctx: Any, grad_dist2: Tensor, _: Tensor | None) -> tuple[Tensor, None, None, None, None]:
    h, index = ctx.saved_tensors
    return _rasterize_points_backward(h, *ctx.drawing, index, grad_dist2), None, None, None, None


_rasterize_points.register_autograd(_grad_points, setup_context=_save_points)


@torch.library.custom_op("nmbg::rasterize_faces", mutates_args=(), device_types="cpu")
def _rasterize_faces(
    h: Tensor, faces: Tensor, height: int, width: int, levels: int
) -> tuple[Tensor, Tensor, Tensor]:
    face, bary, depth = _core.rasterize_faces(
        array("h", h), array("faces", faces), height, width, levels, torch.get_num_threads()
    )
    return torch.from_numpy(bary), torch.from_numpy(depth), torch.from_numpy(face)


@_rasterize_faces.register_fake
def _(h: Tensor, faces: Tensor, height: int, width: int, levels: int) -> tuple[Tensor, Tensor, Tensor]:
    pixels = sum(rows * columns for rows, columns in _sizes(height, width, levels))
    return h.new_empty((pixels, 3)), h.new_empty(pixels), h.new_empty(pixels, dtype=torch.int32)


@torch.library.custom_op("nmbg::rasterize_faces_backward", mutates_args=(), device_types="cpu")
def _rasterize_faces_backward(
    h: Tensor,
    faces: Tensor,
    height: int,
    width: int,
    levels: int,
    face: Tensor,
    grad_bary: Tensor,
    grad_depth: Tensor,
) -> Tensor:
    return torch.from_numpy(
        _core.rasterize_faces_backward(
            array("h", h),
            array("faces", faces),
            height,
            width,
            levels,
            array("face", face),
            array("grad_bary", grad_bary),
            array("grad_depth", grad_depth),
            torch.get_num_threads(),
        )
    )


@_rasterize_faces_backward.register_fake
def _(
    h: Tensor,
    faces: Tensor,
    height: int,
    width: int,
    levels: int,
    face: Tensor,
    grad_bary: Tensor,
    grad_depth: Tensor,
) -> Tensor:
    return h.new_empty(h.shape)


def _save_faces(
    ctx: Any, inputs: tuple[Tensor, Tensor, int, int, int], output: tuple[Tensor, Tensor, Tensor]
) -> None:
    h, faces, *ctx.size = inputs
    _, _, face = output
    ctx.mark_non_differentiable(face)
    ctx.save_for_backward(h, faces, face)


def _grad_faces(
    ctx: Any, grad_bary: Tensor, grad_depth: Tensor, _: Tensor | None
) -> tuple[Tensor, None, None, None, None]:
    h, faces, face = ctx.saved_tensors
    grad = _rasterize_faces_backward(h, faces, *ctx.size, face, grad_bary, grad_depth)
    return grad, None, None, None, None


_rasterize_faces.register_autograd(_grad_faces, setup_context=_save_faces)


def _sizes(height: int, width: int, levels: int) -> list[tuple[int, int]]:
    """Rows and columns of each level of a pyramid."""
    return [(-(-height // 2**k), -(-width // 2**k)) for k in range(levels)]


class PointHits(NamedTuple):
    """The points that the pixels of an image see.

    Args:
        point: [H, W] int32, the point of the smallest z (of equal ones, the lowest index), −1 where none.
        dist2: [H, W] squared distance from the projected point to the pixel centre in px², 0 where none.
    """

    point: Tensor
    dist2: Tensor


def rasterize_points(
    h: Tensor,  # [N, 3]
    radius_px: float,
    height: int,
    width: int,
) -> PointHits:
    """The nearest point whose projection lies within a radius of each pixel centre.

    Args:
        h: [N, 3] float32 or float64, homogeneous pixels (u·z, v·z, z); points with z ≤ 0 or values that are
            not finite are not drawn.
        radius_px: a point is a candidate strictly within this distance, in pixels.
        height: image height in pixels.
        width: image width in pixels.

    Returns:
        What each pixel sees; `dist2` has the dtype of `h` and is differentiable with respect to it.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    return rasterize_points_pyramid(h, radius_px, height, width, 1)[0]


def rasterize_points_pyramid(
    h: Tensor,  # [N, 3]
    radius_px: float,
    height: int,
    width: int,
    levels: int,
) -> list[PointHits]:
    """rasterize_points() for an image and its halvings: level k shows (u, v) / 2ᵏ on ⌈size / 2ᵏ⌉ pixels.

    Args:
        h: [N, 3] float32 or float64, homogeneous pixels of the finest level.
        radius_px: of the discs, in pixels of each level.
        height: finest image height in pixels.
        width: finest image width in pixels.
        levels: how many images.

    Returns:
        What each pixel sees per level, finest first, as rasterize_points() returns it.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    dist2, index = _rasterize_points(h, radius_px, height, width, levels)
    sizes = _sizes(height, width, levels)
    parts = [part.split([rows * columns for rows, columns in sizes]) for part in (index, dist2)]
    return [PointHits(i.view(size), d.view(size)) for i, d, size in zip(*parts, sizes, strict=True)]


class FaceHits(NamedTuple):
    """The faces that the pixels of an image see.

    Args:
        face: [H, W] int32, the face of the smallest z (of equal ones, the lowest index), −1 where none.
        bary: [H, W, 3] perspective-correct barycentrics, 0 where none.
        depth: [H, W] view-space z, 0 where none.
    """

    face: Tensor
    bary: Tensor
    depth: Tensor


def rasterize_faces(
    h: Tensor,  # [N, 3]
    faces: Tensor,  # [M, 3]
    height: int,
    width: int,
) -> FaceHits:
    """The nearest face along the ray through each pixel centre.

    Faces that cross the camera plane are drawn as far as they are in front of it. A pixel centre on the edge
    between two faces belongs to exactly one of them. Both sides of a face are drawn.

    Args:
        h: [N, 3] float32 or float64, homogeneous pixels (u·z, v·z, z); faces without area or with values that
            are not finite are not drawn.
        faces: [M, 3] int32, the vertices of each face.
        height: image height in pixels.
        width: image width in pixels.

    Returns:
        What each pixel sees; `bary` and `depth` have the dtype of `h` and are differentiable with respect to
        it.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    return rasterize_faces_pyramid(h, faces, height, width, 1)[0]


def rasterize_faces_pyramid(
    h: Tensor,  # [N, 3]
    faces: Tensor,  # [M, 3]
    height: int,
    width: int,
    levels: int,
) -> list[FaceHits]:
    """rasterize_faces() for an image and its halvings: level k shows (u, v) / 2ᵏ on ⌈size / 2ᵏ⌉ pixels.

    Args:
        h: [N, 3] float32 or float64, homogeneous pixels of the finest level.
        faces: [M, 3] int32, the vertices of each face.
        height: finest image height in pixels.
        width: finest image width in pixels.
        levels: how many images.

    Returns:
        What each pixel sees per level, finest first, as rasterize_faces() returns it.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    bary, depth, face = _rasterize_faces(h, faces, height, width, levels)
    sizes = _sizes(height, width, levels)
    parts = [part.split([rows * columns for rows, columns in sizes]) for part in (face, bary, depth)]
    return [
        FaceHits(f.view(size), b.view(*size, 3), d.view(size))
        for f, b, d, size in zip(*parts, sizes, strict=True)
    ]
