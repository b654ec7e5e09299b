"""L_rec, and the features of training photographs that it compares with, kept from epoch to epoch."""

from __future__ import annotations

import torch
from torch import Tensor

from nmbg.losses import Perceptual
from nmbg.training.views import GIB


class PerceptualTerm:
    """The loss with the features of its targets, which are computed once and kept up to a limit.

    They are kept in half precision, and used so from the first time on: no number depends on what is kept.

    Args:
        loss: compares features.
        cache_gib: memory for features, GiB; 0 where targets differ from step to step.
    """

    def __init__(self, loss: Perceptual, cache_gib: float) -> None:
        self.loss = loss
        self._free = int(cache_gib * GIB)
        self._cache: dict[str, list[Tensor]] = {}

    @torch.no_grad()
    def of_target(self, name: str, image: Tensor) -> list[Tensor]:
        """Features of a training photograph per layer, [1, C, h, w].

        Args:
            name: of the view; while features are kept, the same image belongs to it every time.
            image: [1, 3, H, W] in [0, 1].
        """
        if name in self._cache:
            return [feature.float() for feature in self._cache[name]]
        features = [feature.half() for feature in self.loss.features(image)]
        size = sum(feature.nbytes for feature in features)
        if size <= self._free:
            self._free -= size
            self._cache[name] = features
        return [feature.float() for feature in features]
