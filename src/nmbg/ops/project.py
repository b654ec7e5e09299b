"""Projection of world points into homogeneous pixels, and the rays of pixels back into the world."""

from __future__ import annotations

from typing import Any

import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
from torch import Tensor

from nmbg import _core
from nmbg.ops._arrays import array


@torch.library.custom_op("nmbg::project", mutates_args=(), device_types="cpu")
def _project(points: Tensor, P: Tensor) -> Tensor:
    return torch.from_numpy(_core.project(array("P", P), array("points", points), torch.get_num_threads()))


@_project.register_fake
def _(points: Tensor, P: Tensor) -> Tensor:
    return points.new_empty(points.shape)


def _save(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
    ctx.P = inputs[1]


def _grad(ctx: Any, grad_h: Tensor) -> tuple[Tensor, None]:
    return (grad_h.double() @ ctx.P[:, :3]).to(grad_h.dtype), None


_project.register_autograd(_grad, setup_context=_save)


def project(
    points: Tensor,  # [N, 3]
    P: Tensor,  # [3, 4]
) -> Tensor:
    """Homogeneous pixels P · (x, y, z, 1), summed in float64 whatever the dtype of the points.

    Args:
        points: [N, 3] float32 or float64, on the CPU.
        P: [3, 4] float64, on the CPU; a constant.

    Returns:
        [N, 3] in the dtype of `points`, differentiable with respect to them.

    Raises:
        TypeError, ValueError: an argument of another dtype or shape than said here.
    """
    h: Tensor = _project(points, P)
    return h


def pixel_rays(
    M: Tensor,  # [3, 3]
    height: int,
    width: int,
    dtype: torch.dtype = torch.float32,
) -> Tensor:  # [H, W, 3]
    """Unit vectors along M · (x + ½, y + ½, 1) of all pixels (x, y) of an image; not differentiable.

    What a row or a column of the image shares is computed in float64 and rounded; a sum and a division per
    pixel are left.

    Args:
        M: [3, 3] float64, on the CPU.
        height: of the image, pixels.
        width: of the image, pixels.
        dtype: float32 or float64.

    Returns:
        [H, W, 3] in that dtype.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    if dtype not in (torch.float32, torch.float64):
        raise TypeError(f"dtype: expected float32 or float64, got {dtype}")
    single = dtype == torch.float32
    return torch.from_numpy(_core.rays(array("M", M), height, width, single, torch.get_num_threads()))
