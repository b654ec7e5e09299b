"""What the views see of a mesh: covered pixels, depth, and how much of it each layer holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.ops import face_depth, rasterize_faces
from nmbg.scene import Split

# Longer side of the views in which holes are counted and closed, pixels.
SIGHT_SIZE = 320


@dataclass(frozen=True)
class Sight:
    """What one camera sees of a mesh.

    Args:
        camera: the camera, at the size of the images below.
        face: [H, W] int32, the nearest face, −1 where none.
        depth: [H, W] float32 view-space z, scene units; 0 where the mesh is not seen.
    """

    camera: Camera
    face: Tensor
    depth: Tensor

    @property
    def covered(self) -> Tensor:
        """Where the mesh is seen, [H, W] bool."""
        return self.face >= 0


def reduced(camera: Camera, longest: int = SIGHT_SIZE) -> Camera:
    """The camera at no more than `longest` pixels on its longer side."""
    scale = min(1.0, longest / max(camera.width, camera.height))
    return camera.resized(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))


def look(mesh: Mesh, camera: Camera) -> Sight:
    """Rasterize the mesh for one camera, with depth."""
    faces = torch.from_numpy(mesh.faces)
    h = camera.project(torch.from_numpy(mesh.vertices))
    face, bary = rasterize_faces(h, faces, camera.height, camera.width)
    return Sight(camera, face, face_depth(face, bary, faces, h))


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
