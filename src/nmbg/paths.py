"""Camera paths between photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from nmbg.cameras import Camera

# Two cameras at one place still take this share of the mean time from one to the next.
LEAST = 0.1


def through(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """A smooth path through cameras, in their order, at a steady pace.

    Cubic splines of centres and rotations over the distances from one camera to the next. Intrinsics and size
    are those of the first camera.

    Args:
        cameras: to pass through, two or more.
        frames: cameras on the path, two or more; the first and the last stand where the path begins and ends.

    Raises:
        ValueError: fewer than two cameras or frames.
    """
    if len(cameras) < 2 or frames < 2:
        raise ValueError(f"a path needs two cameras and two frames, got {len(cameras)} and {frames}")
    centres = np.stack([camera.centre for camera in cameras])
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    steps = np.maximum(steps, LEAST * steps.mean()) if steps.any() else np.ones(len(steps))
    times = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, times[-1], frames)
    places = CubicSpline(times, centres)(at)
    rotations = RotationSpline(times, Rotation.from_matrix(np.stack([camera.R for camera in cameras])))(at)
    return [
        replace(cameras[0], R=R, t=-R @ place) for R, place in zip(rotations.as_matrix(), places, strict=True)
    ]
