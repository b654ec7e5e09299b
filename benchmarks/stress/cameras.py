"""Training cameras that are not where, or not what, they are said to be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from nmbg.cameras import Camera
from nmbg.scene import Scene
from stress.scenes import Random, Stress


def change(scene: Scene, changed: Callable[[Camera], Camera]) -> Scene:
    """The scene with other training cameras."""
    views = tuple(replace(v, camera=changed(v.camera)) if v.split == "train" else v for v in scene.views)
    return replace(scene, views=views)


def disturbed(scene: Scene, degrees: float, share: float, random: Random) -> Scene:
    """Training cameras are turned by so many degrees, and moved by this share of the radius."""

    def moved(camera: Camera) -> Camera:
        axis, direction = (x / np.linalg.norm(x) for x in random.normal(size=(2, 3)))
        R = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix() @ camera.R
        return replace(camera, R=R, t=-R @ (camera.centre + share * scene.radius * direction))

    return change(scene, moved) if degrees or share else scene


def with_focal_length(scene: Scene, severity: float, random: Random) -> Scene:
    """The focal length is taken to be longer by this share."""
    longer = np.diag([severity, severity, 0])
    return change(scene, lambda camera: replace(camera, K=camera.K * (1 + longer)))


def with_principal_point(scene: Scene, severity: float, random: Random) -> Scene:
    """The principal point is taken to be further right by this share of the width."""

    def moved(camera: Camera) -> Camera:
        return camera.cropped(-severity * camera.width, 0, camera.width, camera.height)

    return change(scene, moved)


CAMERAS = (
    Stress("rotation", "cameras", "degrees", (0, 0.1, 0.5, 2), lambda s, x, r: disturbed(s, x, 0, r)),
    Stress(
        "position",
        "cameras",
        "share of the radius",
        (0, 0.002, 0.01, 0.05),
        lambda s, x, r: disturbed(s, 0, x, r),
    ),
    Stress("focal length", "cameras", "share", (0, 0.01, 0.03, 0.1), with_focal_length),
    Stress("principal point", "cameras", "share of the width", (0, 0.005, 0.02, 0.06), with_principal_point),
)
