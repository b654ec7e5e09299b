"""Exposures of the training photographs, where they differ enough to be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from nmbg.images import from_bytes
from nmbg.model.exposure import Exposures, fit_exposure, mean_exposure
from nmbg.progress import console
from nmbg.reconstruct.prediction import shade
from nmbg.scene import Scene, View, evenly

# So much nearer to a photograph must its neighbours' exposures bring the mesh, dB (docs/quality.md).
HELPS = 1.0
# So many photographs are left out in turn.
JUDGES = 32


def find_exposures(scene: Scene, views: Sequence[View]) -> Exposures | None:
    """How photographs differ from the mean colours on the mesh.

    Args:
        scene: gives photographs, masks and geometry.
        views: whose photographs.

    Returns:
        one exposure a photograph; None where a photograph's neighbours say too little about its own.
    """
    values = tuple(fit_exposure(*_colours(scene, view)) for view in views)
    centres = np.stack([view.camera.centre for view in views])
    found = Exposures(tuple(view.name for view in views), centres, values)
    gained = _gained(scene, found, evenly(views, JUDGES))
    told = "told apart" if gained >= HELPS else "taken as equal"
    console.print(f"exposures are {told}: neighbours' bring the mesh {gained:.1f} dB nearer to a photograph")
    return found if gained >= HELPS else None


def _gained(scene: Scene, exposures: Exposures, views: Sequence[View]) -> float:
    """How much nearer to photographs the mesh's colours are when exposed as those around than as all are, dB.

    What all share, as the contrast that a mean over photographs loses, is no difference between them.
    """
    errors = torch.zeros(2, dtype=torch.float64)
    for view in views:
        image, colour, counted = _colours(scene, view)
        own = exposures.names.index(view.name)
        others = [exposure for i, exposure in enumerate(exposures.values) if i != own]
        everywhere = mean_exposure(others, len(others) * [1 / max(1, len(others))])
        around = exposures.around(view.camera.centre, {view.name})
        alike = counted & exposures.values[own].alike(image, colour)
        for i, exposure in enumerate((everywhere, around)):
            errors[i] += float(((exposure.apply(colour) - image).square() * alike).mean())
    return 10 * math.log10(errors[0] / errors[1]) if errors.min() > 0 else 0.0


def _colours(scene: Scene, view: View) -> tuple[Tensor, Tensor, Tensor]:
    """A photograph [3, H, W], the mesh's mean colours there [3, H, W], which pixels count [H, W]."""
    mask = scene.load_mask(view)
    colour, counted = shade(scene.mesh, view.camera)
    if mask is not None:
        counted &= torch.from_numpy(mask)
    return from_bytes(scene.load_image(view)), colour.permute(2, 0, 1) / 255, counted
