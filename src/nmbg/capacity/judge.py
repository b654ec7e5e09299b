"""Training views that judge a size: each is predicted from the photographs of the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from nmbg.evaluation.metrics import ssim
from nmbg.images import from_bytes
from nmbg.scene import Scene, View

# Less of SSIM is no difference, where nothing is lacking.
ROUNDING = 1e-4
# So many views judge.
JUDGES = 12


class Limit(NamedTuple):
    """What a choice may cost.

    Args:
        psnr: dB.
        ssim: share of what SSIM lacks to 1: as decibels, it weighs alike in easy and hard scenes.
    """

    psnr: float
    ssim: float


class Score(NamedTuple):
    """How well left-out views are predicted: means over the views.

    Args:
        psnr: dB, over the pixels that count.
        ssim: of the whole frames.
    """

    psnr: float
    ssim: float

    def cost_beside(self, best: Score) -> str:
        """What is lost against another score, in words."""
        return f"{best.psnr - self.psnr:.3f} dB, {best.ssim - self.ssim:.4f} SSIM"

    def within(self, best: Score, limit: Limit) -> bool:
        """Whether no more than `limit` is lost against another score."""
        lost = best.ssim - self.ssim
        return best.psnr - self.psnr <= limit.psnr and lost <= limit.ssim * (1 - best.ssim) + ROUNDING


# What a single choice may cost: all limits together are 0.13 dB, but for the photographs.
LIMIT = Limit(0.02, 0.005)
# Fewer photographs in a pixel blur less: what SSIM loses by that, LPIPS gains.
SOURCES_LIMIT = Limit(0.03, 0.01)


class Judge:
    """Compares renders of training views with their photographs.

    Args:
        scene: gives photographs and masks.
        views: that judge.
    """

    def __init__(self, scene: Scene, views: Sequence[View]) -> None:
        self.views = tuple(views)
        self._load = cache(lambda view: (scene.load_image(view), scene.load_mask(view)))

    def score(self, render: Callable[[View], Tensor]) -> Score:
        """Score of renders [3, H, W] in [0, 1] of the judging views."""
        psnr = similarity = 0.0
        for view in self.views:
            target, counts = self._wanted(view)
            estimate = render(view).clamp(0, 1) * counts
            error = (estimate - target * counts).square().sum() / (3 * counts.sum()).clamp(min=1)
            psnr -= 10 * float(torch.log10(error.clamp(min=1e-10)))
            similarity += ssim(estimate, target * counts) if min(target.shape[1:]) > 5 else 0.0
        return Score(psnr / len(self.views), similarity / len(self.views))

    def _wanted(self, view: View) -> tuple[Tensor, Tensor]:
        """A photograph [3, H, W] in [0, 1], and which of its pixels count, [H, W] of 0 and 1."""
        image, mask = self._load(view)
        target = from_bytes(image)
        return target, torch.ones(target.shape[1:]) if mask is None else torch.from_numpy(mask).float()
