"""The degree of the harmonics of each vertex, by cross-validation in closed form."""

from __future__ import annotations

import torch
from torch import Tensor

# Steps, of 255, by which a higher degree must predict left-out colours better; least detail first.
STEPS = (64.0, 16.0, 8.0, 4.0, 2.0)
# Where the search for the largest step that costs little begins.
USUAL_STEP = STEPS.index(16.0)


def degrees_for(gains: list[Tensor], step: float) -> list[Tensor]:
    """Degree of each vertex, [N] int64 per layer: the best one that gains a step on left-out folds, or 0.

    Args:
        gains: [N, degrees] per layer, `ColourFit.gains()` of two folds or more.
        step: of 255: root of what a degree must take from the mean squared error of left-out colours.
    """
    chosen = []
    for gain in gains:
        best = gain.max(1)
        # A degree that is as good as a higher one is enough.
        enough = (gain >= best.values[:, None] - (step / 255) ** 2 / 2).long().argmax(1)
        chosen.append(torch.where(best.values > (step / 255) ** 2, enough, 0))
    return chosen


def floats(degrees: list[Tensor], features: int) -> int:
    """Coefficients that vertices of these degrees need."""
    return features * sum(int((d + 1).square().sum()) for d in degrees)
