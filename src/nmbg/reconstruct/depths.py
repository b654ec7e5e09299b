"""Depth where nothing is known, filled from around it, and the points that depths stand for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera

Floats = npt.NDArray[np.float64]

# Exponent of the power mean that fills depth; the larger, the more the far side wins.
FAR_EXPONENT = 12


def fill_depth(depth: Tensor, known: Tensor) -> Tensor:
    """Fill unknown depth by push–pull: averages over ever larger blocks of pixels, then interpolated back.

    Args:
        depth: [H, W] positive where known, scene units.
        known: [H, W] bool, somewhere true.

    Returns:
        [H, W] float64: `depth` where known, else a power mean of the known depths around, far ones first.
    """
    largest = depth[known].max().double()
    value = torch.where(known, (depth.double() / largest).clamp(min=0) ** FAR_EXPONENT, 0.0)[None, None]
    filled = push_pull(value, known.double()[None, None])[0, 0] ** (1 / FAR_EXPONENT) * largest
    return torch.where(known, depth.double(), filled)


def push_pull(value: Tensor, weight: Tensor) -> Tensor:
    """Fill an image [1, 1, H, W] where the weight, of the same shape, is 0; elsewhere it stays."""
    height, width = value.shape[2:]
    if height == width == 1:
        return value
    odd = (0, width % 2, 0, height % 2)
    total = F.avg_pool2d(F.pad(weight, odd), 2)
    mean = F.avg_pool2d(F.pad(value * weight, odd), 2) / total.clamp(min=1e-12)
    coarse = push_pull(mean, (total > 0).double())
    fine = F.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
    return torch.where(weight > 0, value, fine[..., :height, :width])


def unproject(camera: Camera, depth: Tensor) -> Floats:
    """World points [H, W, 3] float64 at the pixel centres, for view-space depth [H, W]."""
    rays = camera.rays(torch.float64)
    along_axis = rays @ torch.from_numpy(camera.axis)
    points: Floats = (camera.centre + (rays * (depth.double() / along_axis)[..., None]).numpy()).astype(
        np.float64
    )
    return points
