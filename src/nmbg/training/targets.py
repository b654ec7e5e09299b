"""L_rec, and the features of training photographs that it compares with, kept from epoch to epoch."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from nmbg.losses import Perceptual
from nmbg.training.shelf import Shelf


class PerceptualTerm:
    """The loss with the features of its targets, which are computed once where there is room to keep them.

    They are kept in half precision, and used so from the first time on: no number depends on what is kept.

    Args:
        loss: compares features.
        cache_gib: memory for features, GiB; 0 where targets differ from step to step.
        folder: that takes those beyond it; None for memory alone.
    """

    def __init__(self, loss: Perceptual, cache_gib: float, folder: Path | None = None) -> None:
        self.loss = loss
        self._shelf: Shelf[list[Tensor]] = Shelf(cache_gib, folder)

    @torch.no_grad()
    def of_target(self, name: str, image: Tensor) -> list[Tensor]:
        """Features of a training photograph per layer, [1, C, h, w].

        Args:
            name: of the view; while features are kept, the same image belongs to it every time.
            image: [1, 3, H, W] in [0, 1].
        """
        features = self._shelf.get(name)
        if features is None:
            features = [feature.half() for feature in self.loss.features(image)]
            self._shelf.put(name, features, sum(feature.nbytes for feature in features))
        return [feature.float() for feature in features]
