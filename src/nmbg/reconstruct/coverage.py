"""What the views see of a mesh: covered pixels, depth, and how much of it each layer holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.scene import Split
from nmbg.sight import Sight

# Longer side of the views in which holes are counted and closed, pixels.
SIGHT_SIZE = 320


def behind(front: Sight, back: Sight, offset: int) -> Sight:
    """One view of two meshes as one: the nearer is seen; faces of the second count from `offset` on."""
    nearer = back.covered & ~(front.covered & (front.depth <= back.depth))
    face = torch.where(nearer, back.face + offset, front.face)
    return Sight(front.camera, face, torch.where(nearer, back.depth, front.depth))


def mask_at(mask: npt.NDArray[np.bool_] | None, camera: Camera) -> npt.NDArray[np.bool_]:
    """A view's mask [h, w] at the pixel centres of a smaller camera, [H, W] bool; all true without one."""
    if mask is None:
        return np.ones((camera.height, camera.width), dtype=bool)
    rows = ((np.arange(camera.height) + 0.5) * mask.shape[0] / camera.height).astype(int)
    columns = ((np.arange(camera.width) + 0.5) * mask.shape[1] / camera.width).astype(int)
    sampled: npt.NDArray[np.bool_] = mask[rows[:, None], columns]
    return sampled


@dataclass(frozen=True)
class ViewCoverage:
    """What a view sees, as shares of the pixels inside its mask.

    Args:
        split: of the view.
        kept: share of the image inside the mask.
        mesh: pixels that see the mesh.
        patches: pixels that see a patch.
        shell: pixels that see the shell.
        foreground: pixels whose face belongs to the foreground layer.
    """

    split: Split
    kept: float
    mesh: float
    patches: float
    shell: float
    foreground: float


def count_coverage(
    split: Split, mask: npt.NDArray[np.bool_], face: Tensor, parts: Sequence[int], foreground: Tensor
) -> ViewCoverage:
    """Count the pixels of a view that see each part of a mesh.

    Args:
        split: of the view.
        mask: [H, W] bool, the pixels that count.
        face: [H, W] int32, the nearest face, −1 where none.
        parts: how many faces mesh, patches and shell have, in this order.
        foreground: [M] bool, whether a face belongs to the foreground layer.
    """
    inside = face[torch.from_numpy(mask)]
    n = max(1, len(inside))
    hit = inside[inside >= 0].long()
    part = torch.bucketize(hit, torch.tensor(parts).cumsum(0), right=True)
    mesh, patches, shell = (torch.bincount(part, minlength=3).double() / n).tolist()
    return ViewCoverage(split, mask.mean().item(), mesh, patches, shell, foreground[hit].sum().item() / n)
