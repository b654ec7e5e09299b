"""The plainest baseline: the photograph of the nearest training camera, warped over the mesh as it is."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from warp import places

from nmbg.atomic import atomic_folder
from nmbg.cameras import Camera
from nmbg.evaluation.judge import render_names
from nmbg.images import Image, write_image
from nmbg.scene import Scene, View
from nmbg.sight import look


def render_nearest(scene: Scene, folder: Path) -> float:
    """Write a picture of each held-out view, called as its photograph.

    Args:
        scene: the scene.
        folder: where to write; replaced if it is there.

    Returns:
        seconds per frame: the median, reading the photograph and writing the picture left out.
    """
    seconds = []
    with atomic_folder(folder, overwrite=True) as pictures:
        for view, name in zip(scene.test, render_names(scene.test), strict=True):
            source = nearest(scene, view.camera)
            photograph = scene.load_image(source)
            start = time.perf_counter()
            image = warp(scene, view.camera, source.camera, photograph)
            seconds.append(time.perf_counter() - start)
            (pictures / name).parent.mkdir(parents=True, exist_ok=True)
            write_image(pictures / f"{name}.png", image)
    return statistics.median(seconds)


def nearest(scene: Scene, camera: Camera) -> View:
    """The training view whose camera stands nearest, of those that look less than 90° away."""
    alike = [view for view in scene.train if view.camera.axis @ camera.axis > 0] or list(scene.train)
    return min(alike, key=lambda view: float(np.linalg.norm(view.camera.centre - camera.centre)))


def warp(scene: Scene, camera: Camera, source: Camera, photograph: Image) -> Image:
    """What a photograph shows at the surface that a camera sees, [H, W, 3] uint8.

    Nothing asks whether the photograph sees that surface; black where there is no surface, or where the
    photograph ends.
    """
    depth = look(scene.mesh, camera).depth
    grid, _ = places(source, camera, depth)
    texels = torch.from_numpy(photograph).permute(2, 0, 1).float()[None]
    shown = F.grid_sample(texels, grid[None], padding_mode="zeros", align_corners=False)[0]
    image: Image = (shown * (depth > 0)).permute(1, 2, 0).round().to(torch.uint8).numpy()
    return image
