"""Exposure: how the colours of a photograph differ from those on the mesh, and a new view's from both.

The mesh averages all photographs. One that was taken darker or warmer differs from it by an affine map per
channel; near photographs, taken soon after one another, by nearly the same. A new view is shown as its
neighbours were exposed; nothing is fitted to what it is compared with.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

# Pixels whose colour differs by more show something else than the mesh does.
ALIKE = 0.1
# How often it is asked which pixels look alike.
PASSES = 4
# Of about so many pixels, on a grid over the photograph.
PIXELS = 2**15
# Added to the variance of colours: what shows one colour alone says nothing about gains.
RIDGE = 1e-3
# A view is exposed as so many photographs around it.
NEIGHBOURS = 4
# What the next one's closeness takes from theirs; where all are as close, all count the same.
LIMIT_SHARE = 1 - 1e-4


class Exposure(NamedTuple):
    """colour as photographed = gain · colour on the mesh + offset.

    Args:
        gain: [3, 1, 1] float32.
        offset: [3, 1, 1] float32.
    """

    gain: Tensor
    offset: Tensor

    def apply(self, colour: Tensor) -> Tensor:
        """Expose a colour image [3, H, W]."""
        return self.gain * colour + self.offset

    def to(self, device: torch.device) -> Exposure:
        """The same on a device."""
        return Exposure(self.gain.to(device), self.offset.to(device))

    def undo(self, image: Tensor) -> Tensor:
        """The colours on the mesh that a photograph [3, H, W] shows."""
        return (image - self.offset) / self.gain

    def alike(self, image: Tensor, colour: Tensor) -> Tensor:
        """Where a photograph [3, H, W] shows what the mesh does, [H, W] bool."""
        return (self.undo(image) - colour).abs().amax(0) < ALIKE


UNCHANGED = Exposure(torch.ones(3, 1, 1), torch.zeros(3, 1, 1))


@dataclass(frozen=True, eq=False)
class Exposures:
    """How photographs were exposed.

    Args:
        names: of the photographs.
        centres: [N, 3] float64 of their cameras.
        values: one per photograph.
    """

    names: tuple[str, ...]
    centres: npt.NDArray[np.float64]
    values: tuple[Exposure, ...]

    def of(self, name: str, centre: npt.NDArray[np.float64]) -> Exposure:
        """The exposure of a photograph; where it is not among these, of those around its camera."""
        return self.values[self.names.index(name)] if name in self.names else self.around(centre)

    def around(self, centre: npt.NDArray[np.float64], without: Set[str] = frozenset()) -> Exposure:
        """The mean exposure of the photographs around a camera centre [3], some of them left out."""
        others = [i for i, name in enumerate(self.names) if name not in without]
        near, weights = neighbours(centre, self.centres[others])
        return mean_exposure([self.values[others[i]] for i in near], weights)


def fit_exposure(image: Tensor, colour: Tensor, counted: Tensor) -> Exposure:
    """Least squares over the pixels that show alike colours; a photograph without any is taken as it is.

    Which pixels do is asked anew of the colours as they were exposed: of a dark photograph only dark pixels
    look alike at first.

    Args:
        image: [3, H, W] float32 photograph in [0, 1].
        colour: [3, H, W] float32 colour on the mesh.
        counted: [H, W] bool, pixels that count.
    """
    step = max(1, round(math.sqrt(counted.numel() / PIXELS)))
    image, colour, counted = (part[..., ::step, ::step].contiguous() for part in (image, colour, counted))
    found = UNCHANGED
    for _ in range(PASSES):
        alike = counted & found.alike(image, colour)
        if not alike.any():
            break
        found = _fit(colour.flatten(1), image.flatten(1), alike.flatten())
    return found


def _fit(x: Tensor, y: Tensor, counted: Tensor) -> Exposure:
    """Exposure that brings colours x nearest to y, both [3, N], where they are counted, [N] bool."""
    share = counted / counted.sum()
    mean_x, mean_y = x @ share, y @ share
    from_mean = x - mean_x[:, None]
    variance = from_mean.square() @ share
    covariance = (from_mean * (y - mean_y[:, None])) @ share
    gain = (covariance + RIDGE) / (variance + RIDGE)
    offset = mean_y - gain * mean_x
    return Exposure(gain[:, None, None], offset[:, None, None])


def neighbours(
    centre: npt.NDArray[np.float64], centres: npt.NDArray[np.float64]
) -> tuple[list[int], list[float]]:
    """The photographs around a view and their weights, which reach 0 where the next one comes in.

    Args:
        centre: [3], of the view.
        centres: [N, 3], of the photographs.

    Returns:
        indices and weights; these sum to one, or there are none.
    """
    distance = np.linalg.norm(centres - centre, axis=1)
    near = distance.argsort(kind="stable")[: NEIGHBOURS + 1]
    limit = max(float(distance[near].max(initial=0)), 1e-12)
    closeness = limit / distance[near].clip(min=1e-3 * limit)
    if len(near) > NEIGHBOURS:
        near, closeness = near[:-1], closeness[:-1] - LIMIT_SHARE * closeness[-1]
    return near.tolist(), (closeness / closeness.sum()).tolist()


def mean_exposure(exposures: list[Exposure], weights: list[float]) -> Exposure:
    """Weighted mean; of none, no change."""
    if not exposures:
        return UNCHANGED
    gains, offsets = (torch.stack(part) for part in zip(*exposures, strict=True))
    shares = torch.tensor(weights)[:, None, None, None]
    return Exposure((shares * gains).sum(0), (shares * offsets).sum(0))
