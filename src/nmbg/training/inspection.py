"""Photographs that cannot be right: black, of something else, or with a pose that is wildly wrong.

Each is compared with the colours on the mesh, which all of them made together, by correlation: exposure does
not count. One that differs far more than the others do teaches nothing and spoils what is blended from it.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from nmbg.images import resize
from nmbg.reconstruct.coverage import mask_at
from nmbg.reconstruct.prediction import shade
from nmbg.scene import Scene

# Longer side of the images that are compared, pixels.
SIZE = 240
# A photograph is left out when it differs more than the median one does, by so many robust deviations and by
# this factor.
DEVIATIONS, FACTOR = 8.0, 2.0
# And by this much at least, of 1 for what has nothing in common: what is nearly perfect may vary.
LEAST_DIFFERENCE = 0.4
# A view that sees surface in a smaller share of its pixels tells nothing.
LEAST_COVERED = 0.01
# Fewer views do not tell which of them is wrong.
LEAST_VIEWS = 6


def doubtful(scene: Scene) -> dict[str, str]:
    """Training views that are better left out, and why.

    Args:
        scene: only its training views are read.
    """
    views = scene.train
    if len(views) < LEAST_VIEWS:
        return {}
    difference, covered = np.zeros(len(views)), np.zeros(len(views))
    for i, view in enumerate(views):
        camera = view.camera.within(SIZE)
        colour, counted = shade(scene.mesh, camera)
        counted &= torch.from_numpy(mask_at(scene.load_mask(view), camera))
        covered[i] = counted.float().mean()
        if covered[i] < LEAST_COVERED:
            continue
        image = torch.from_numpy(resize(scene.load_image(view), camera.width, camera.height))
        difference[i] = 1 - _correlation(image[counted].T, colour[counted].T)
    sees = covered >= LEAST_COVERED
    median = float(np.median(difference[sees])) if sees.any() else 0.0
    spread = 1.4826 * float(np.median(np.abs(difference[sees] - median))) if sees.any() else 0.0
    limit = max(FACTOR * median, median + DEVIATIONS * spread, LEAST_DIFFERENCE)
    found = {}
    for view, share, d in zip(views, covered, difference, strict=True):
        if share < LEAST_COVERED:
            found[view.name] = "it sees no surface: is its pose right?"
        elif d > limit:
            found[view.name] = (
                f"it has little in common with the surface ({1 - d:.2f}, others {1 - median:.2f}): is it the "
                "right photograph, and its pose right?"
            )
    return found if len(found) <= len(views) // 4 else {}


def _correlation(a: Tensor, b: Tensor) -> float:
    """Correlation of colours [3, N], each channel about its own mean; 0 of a plain image."""
    a, b = (x.double() - x.double().mean(1, keepdim=True) for x in (a, b))
    return float((a * b).sum() / (a.norm() * b.norm()).clamp(min=1e-9))


def without(scene: Scene, names: Container[str]) -> Scene:
    """A scene without some of its training views."""
    kept = tuple(view for view in scene.views if view.split != "train" or view.name not in names)
    return replace(scene, views=kept)
