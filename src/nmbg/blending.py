"""Photographs of known cameras, blended into a view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.ops import Blend, blend_photos


def blend_into(
    camera: Camera,
    depth: Tensor,
    others: Sequence[Camera],
    texels: Sequence[Tensor],
    depths: Sequence[Tensor],
    keep: int,
    each: bool = False,
) -> Blend:
    """`blend_photos` of cameras; possibly of none.

    Args:
        camera: the view, H × W pixels.
        depth: [H, W] float32 view-space z of what it sees, 0 where nothing.
        others: the photographs' cameras.
        texels: their mip chains (`mip_chain`).
        depths: per photograph, [h, w] float32 view-space z of the surface, 0 where none may be shown.
        keep: photographs blended in a pixel.
        each: return the colours of the single photographs too.
    """
    warps = np.array([camera.warp_to(other) for other in others]).reshape(-1, 3, 4)
    intrinsics = np.array([other.K for other in others]).reshape(-1, 3, 3)
    return blend_photos(
        depth,
        torch.from_numpy(warps).float(),
        torch.from_numpy(intrinsics).float(),
        float(camera.K[0, 0]),
        texels,
        depths,
        keep=keep,
        each=each,
    )
