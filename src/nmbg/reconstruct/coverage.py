"""What the views see of a mesh: covered pixels, depth, and how much of it each layer holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.ops import face_depth, rasterize_faces
from nmbg.progress import progress_bar
from nmbg.scene import Scene, Split

# Longer side of the views that coverage is counted in, pixels.
COVERAGE_SIZE = 400


@dataclass(frozen=True)
class Sight:
    """What one camera sees of a mesh.

    Args:
        camera: the camera, at the size of the images below.
        covered: [H, W] bool, where the mesh is seen.
        depth: [H, W] float32 view-space z, scene units; 0 where the mesh is not seen.
    """

    camera: Camera
    covered: Tensor
    depth: Tensor


def reduced(camera: Camera, longest: int) -> Camera:
    """The camera at no more than `longest` pixels on its longer side."""
    scale = min(1.0, longest / max(camera.width, camera.height))
    return camera.resized(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))


def visible_faces(mesh: Mesh, camera: Camera) -> npt.NDArray[np.int32]:
    """Index of the nearest face per pixel, [H, W], −1 where none."""
    h = camera.project(torch.from_numpy(mesh.vertices))
    face, _ = rasterize_faces(h, torch.from_numpy(mesh.faces), camera.height, camera.width)
    return face.numpy()


def look(mesh: Mesh, camera: Camera) -> Sight:
    """Rasterize the mesh for one camera, with depth."""
    faces = torch.from_numpy(mesh.faces)
    h = camera.project(torch.from_numpy(mesh.vertices))
    face, bary = rasterize_faces(h, faces, camera.height, camera.width)
    return Sight(camera, face >= 0, face_depth(face, bary, faces, h))


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
        shell: pixels that see the shell.
        foreground: pixels whose face belongs to the foreground layer.
    """

    split: Split
    kept: float
    mesh: float
    shell: float
    foreground: float


def count_coverage(scene: Scene, description: str) -> list[ViewCoverage]:
    """Count, for every view of a scene, the pixels that see its mesh, shell and foreground."""
    mesh = scene.mesh
    inside = np.linalg.norm(mesh.vertices - scene.centre, axis=1) < scene.radius
    foreground = inside[mesh.faces].all(axis=1)
    first_shell = len(mesh.faces) - scene.shell_faces
    out = []
    with progress_bar() as bar:
        for view in bar.track(scene.views, description=description):
            camera = reduced(view.camera, COVERAGE_SIZE)
            mask = mask_at(scene.load_mask(view), camera)
            face = visible_faces(mesh, camera)[mask]
            n = max(1, face.size)
            hit = face[face >= 0]
            shell = int((hit >= first_shell).sum())
            near = int(foreground[hit].sum())
            out.append(
                ViewCoverage(view.split, mask.mean().item(), (len(hit) - shell) / n, shell / n, near / n)
            )
    return out
