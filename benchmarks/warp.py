"""What one picture shows of what another camera sees, by depth."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera

DEPTH_TOLERANCE = 0.02


def warped(
    image: Tensor, camera: Camera, depth: Tensor, other: Camera, other_depth: Tensor
) -> tuple[Tensor, Tensor]:
    """A picture as another camera would see it.

    Args:
        image: [3, H, W], taken by `camera`.
        camera: where it was taken.
        depth: [H, W] float32 view-space z there, 0 where no surface is.
        other: who looks.
        other_depth: [H′, W′] float32 view-space z of what it sees.

    Returns:
        [3, H′, W′], and [H′, W′] bool: where both see the same surface.
    """
    grid, z = places(camera, other, other_depth)
    fetched = F.grid_sample(
        torch.cat([image, depth[None]])[None], grid[None], padding_mode="border", align_corners=False
    )[0]
    inside = (grid.abs() < 1).all(-1) & (other_depth > 0)
    return fetched[:3], inside & ((fetched[3] - z).abs() < DEPTH_TOLERANCE * z)


def places(camera: Camera, other: Camera, other_depth: Tensor) -> tuple[Tensor, Tensor]:
    """Where the surface that another camera sees lies in a picture.

    Args:
        camera: where the picture was taken.
        other: who looks.
        other_depth: [H′, W′] float32 view-space z of what it sees.

    Returns:
        [H′, W′, 2], from −1 to 1 over the picture, and [H′, W′] view-space z of `camera`, at least 1e-6.
    """
    warp = torch.from_numpy(other.warp_to(camera)).float()
    y, x = torch.meshgrid(torch.arange(other.height) + 0.5, torch.arange(other.width) + 0.5, indexing="ij")
    rays = torch.stack([x, y, torch.ones_like(x)], -1) @ warp[:, :3].T
    points = other_depth[..., None] * rays + warp[:, 3]
    h = points @ torch.from_numpy(camera.K).float().T
    z = h[..., 2].clamp(min=1e-6)
    return 2 * h[..., :2] / z[..., None] / torch.tensor([camera.width, camera.height]) - 1, z


def psnr(a: Tensor, b: Tensor, counted: Tensor) -> float | None:
    """PSNR of two images [3, H, W] in [0, 1] over the pixels that count [H, W]; None of none."""
    if not counted.any():
        return None
    return -10 * float(torch.log10((a - b)[:, counted].square().mean().clamp(min=1e-10)))
