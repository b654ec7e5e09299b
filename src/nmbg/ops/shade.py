"""Shading: features of pixels from the descriptors of the vertices that they see."""

from __future__ import annotations

from typing import Any

import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
from torch import Tensor

from nmbg import _core
from nmbg.ops import reference
from nmbg.ops._arrays import array


def _arguments(
    index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor
) -> tuple[Any, ...]:
    return (
        array("index", index),
        array("weight", weight),
        None if faces is None else array("faces", faces),
        array("rays", rays),
        array("coeffs", coeffs),
        torch.get_num_threads(),
    )


# One op for both kinds of pixels: weight is [H, W, 1] over points, [H, W, 3] over faces.
@torch.library.custom_op("nmbg::shade", mutates_args=(), device_types="cpu")
def _shade(index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor) -> Tensor:
    return torch.from_numpy(_core.shade(*_arguments(index, weight, faces, rays, coeffs)))


@_shade.register_fake
def _(index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor) -> Tensor:
    return coeffs.new_empty((coeffs.shape[2], *index.shape))


@torch.library.custom_op("nmbg::shade_backward_coeffs", mutates_args=(), device_types="cpu")
def _shade_backward_coeffs(
    grad_out: Tensor, index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor
) -> Tensor:
    return torch.from_numpy(
        _core.shade_backward_coeffs(
            array("grad_out", grad_out), *_arguments(index, weight, faces, rays, coeffs)
        )
    )


@_shade_backward_coeffs.register_fake
def _(
    grad_out: Tensor, index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor
) -> Tensor:
    return coeffs.new_empty(coeffs.shape)


@torch.library.custom_op("nmbg::shade_backward_pixels", mutates_args=(), device_types="cpu")
def _shade_backward_pixels(
    grad_out: Tensor, index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor
) -> tuple[Tensor, Tensor]:
    grad_weight, grad_rays = _core.shade_backward_pixels(
        array("grad_out", grad_out), *_arguments(index, weight, faces, rays, coeffs)
    )
    return torch.from_numpy(grad_weight), torch.from_numpy(grad_rays)


@_shade_backward_pixels.register_fake
def _(
    grad_out: Tensor, index: Tensor, weight: Tensor, faces: Tensor | None, rays: Tensor, coeffs: Tensor
) -> tuple[Tensor, Tensor]:
    return weight.new_empty(weight.shape), rays.new_empty(rays.shape)


def _save(ctx: Any, inputs: tuple[Tensor, Tensor, Tensor | None, Tensor, Tensor], output: Tensor) -> None:
    ctx.save_for_backward(*inputs)


def _grad(ctx: Any, grad_out: Tensor) -> tuple[Tensor | None, ...]:
    _, needs_weight, _, needs_rays, needs_coeffs = ctx.needs_input_grad
    grad_weight = grad_rays = grad_coeffs = None
    if needs_weight or needs_rays:
        grad_weight, grad_rays = _shade_backward_pixels(grad_out, *ctx.saved_tensors)
    if needs_coeffs:
        grad_coeffs = _shade_backward_coeffs(grad_out, *ctx.saved_tensors)
    return None, grad_weight, None, grad_rays, grad_coeffs


_shade.register_autograd(_grad, setup_context=_save)


def shade_points(
    index: Tensor,  # [H, W]
    weight: Tensor,  # [H, W]
    rays: Tensor,  # [H, W, 3]
    coeffs: Tensor,  # [N, B, C]
) -> Tensor:  # [C, H, W]
    """Features of pixels that see points: weight · Σ_b Y_b(ray) · coeffs[index, b].

    Args:
        index: [H, W] int32, the point of each pixel, −1 for none.
        weight: [H, W] in the dtype of `coeffs`.
        rays: [H, W, 3] in the dtype of `coeffs`, unit world-space directions through the pixel centres.
        coeffs: [N, B, C] float32 or float64, C features × B = 1, 4 or 9 spherical-harmonic coefficients.

    Returns:
        [C, H, W] in the dtype of `coeffs`, 0 where no point; differentiable with respect to `weight`, `rays`
        and `coeffs`.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    if coeffs.device.type != "cpu":  # no kernel there yet: the twin is plain torch and runs anywhere
        return reference.shade_points(index, weight, rays, coeffs)
    features: Tensor = _shade(index, weight.unsqueeze(-1), None, rays, coeffs)
    return features


def shade_faces(
    face: Tensor,  # [H, W]
    bary: Tensor,  # [H, W, 3]
    faces: Tensor,  # [M, 3]
    rays: Tensor,  # [H, W, 3]
    coeffs: Tensor,  # [N, B, C]
) -> Tensor:  # [C, H, W]
    """Features of pixels that see faces: Σ_k bary_k · Σ_b Y_b(ray) · coeffs[faces[face, k], b].

    Args:
        face: [H, W] int32, the face of each pixel, −1 for none.
        bary: [H, W, 3] in the dtype of `coeffs`, barycentrics.
        faces: [M, 3] int32, the rows of `coeffs` at the corners of each face.
        rays: [H, W, 3] in the dtype of `coeffs`, unit world-space directions through the pixel centres.
        coeffs: [N, B, C] float32 or float64, C features × B = 1, 4 or 9 spherical-harmonic coefficients.

    Returns:
        [C, H, W] in the dtype of `coeffs`, 0 where no face; differentiable with respect to `bary`, `rays`
        and `coeffs`.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    if coeffs.device.type != "cpu":
        return reference.shade_faces(face, bary, faces, rays, coeffs)
    features: Tensor = _shade(face, bary, faces, rays, coeffs)
    return features


def scatter_faces(
    pixels: Tensor,  # [C, H, W]
    face: Tensor,  # [H, W]
    bary: Tensor,  # [H, W, 3]
    faces: Tensor,  # [M, 3]
    rays: Tensor,  # [H, W, 3]
    vertices: int,
    basis: int,
) -> Tensor:  # [N, B, C]
    """Transpose of shade_faces(): Σ over pixels of bary_k · Y_b(ray) · pixel, at the vertices of their faces.

    Args:
        pixels: [C, H, W] float32 or float64.
        face: as for shade_faces(), like `bary`, `faces` and `rays`.
        vertices: N, rows of the result.
        basis: B = 1, 4 or 9.

    Returns:
        [N, B, C] in the dtype of `pixels`; not differentiable.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    like = pixels.new_empty(vertices, basis, len(pixels))
    sums: Tensor = _shade_backward_coeffs(pixels.detach(), face, bary.detach(), faces, rays, like)
    return sums
