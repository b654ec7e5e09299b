"""Which vertices a scene needs: those that training views, or views between them, can see; and the far shell.

The shell stays whole: behind what no view was expected to see, it is better than nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation

from nmbg.cameras import Camera
from nmbg.mesh import Mesh, drop_unused
from nmbg.progress import progress_bar
from nmbg.scene import Scene, evenly
from nmbg.sight import look

# Views between training views that look, at most.
MOST_BETWEEN = 160
# A view's surface hides what stands further behind than this share of its depth.
BEHIND = 0.03
# Views see so much more on each side than their photographs, as a share of it: others stand beside them.
MARGIN = 0.15
# Neighbours of a training view; views look from halfway to each.
NEIGHBOURS = 3


def drop_unseen(scene: Scene) -> Scene:
    """The scene without faces that no training view sees, nor any view halfway between two neighbours."""
    cameras = [view.camera for view in scene.train]
    looking = [*cameras, *evenly(between(cameras), MOST_BETWEEN)]
    seen = seen_faces(scene.mesh, [widened(camera) for camera in looking])
    seen[len(seen) - scene.shell_faces :] = True
    return part(scene, seen)


def part(scene: Scene, keep: npt.NDArray[np.bool_]) -> Scene:
    """The scene with the chosen faces [M] bool, the shell's among them, and the vertices that they use."""
    shell = scene.mesh.faces[len(keep) - scene.shell_faces :]
    return replace(scene, mesh=drop_unused(scene.mesh, keep), shell_vertices=len(np.unique(shell)))


def between(cameras: Sequence[Camera]) -> list[Camera]:
    """Cameras halfway between each one and those nearest to it."""
    centres = np.stack([camera.centre for camera in cameras])
    halfway = []
    for i, camera in enumerate(cameras):
        distance = np.linalg.norm(centres - centres[i], axis=1)
        distance[i] = np.inf
        for j in distance.argsort(kind="stable")[: min(NEIGHBOURS, len(cameras) - 1)]:
            other = cameras[int(j)]
            R = Rotation.from_matrix(np.stack([camera.R, other.R])).mean().as_matrix()
            halfway.append(replace(camera, R=R, t=-R @ (camera.centre + other.centre) / 2))
    return halfway


def widened(camera: Camera) -> Camera:
    """The camera with more to see on all sides."""
    x, y = (round(MARGIN * side) for side in (camera.width, camera.height))
    return camera.cropped(-x, -y, camera.width + 2 * x, camera.height + 2 * y)


def seen_faces(mesh: Mesh, cameras: Sequence[Camera]) -> npt.NDArray[np.bool_]:
    """Faces of which a camera sees a pixel or a vertex, [M] bool: small ones may hold no pixel's centre."""
    vertices = torch.from_numpy(mesh.vertices)
    near = torch.zeros(len(vertices), dtype=torch.bool)
    hit = torch.zeros(len(mesh.faces) + 1, dtype=torch.bool)
    with progress_bar() as bar:
        for camera in bar.track(cameras, description="what views see"):
            sight = look(mesh, camera)
            hit[sight.face.flatten().long()] = True  # −1 marks the spare last entry
            h = camera.project(vertices)
            front = h[:, 2] > 0
            pixel = (h[:, :2] / torch.where(front, h[:, 2], 1.0)[:, None]).floor()
            size = torch.tensor([camera.width, camera.height])
            inside = front & ((pixel >= 0) & (pixel < size)).all(1)
            x, y = torch.where(inside[:, None], pixel, 0).long().unbind(1)
            surface = torch.where(sight.covered, sight.depth, torch.inf)[y, x]
            near |= inside & (h[:, 2] < (1 + BEHIND) * surface)
    seen: npt.NDArray[np.bool_] = near.numpy()[mesh.faces].any(1) | hit[:-1].numpy()
    return seen
