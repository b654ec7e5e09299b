from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from nmbg.losses import Perceptual
from nmbg.training.targets import PerceptualTerm


class Counted(Perceptual):
    """Features by a fixed convolution; counts how often they are asked for."""

    def __init__(self) -> None:
        nn.Module.__init__(self)
        self.asked = 0

    def features(self, image: Tensor) -> list[Tensor]:
        self.asked += 1
        return [image * 3.1, image[:, :1, ::2, ::2] / 7]


@pytest.fixture
def images() -> list[Tensor]:
    g = torch.Generator().manual_seed(0)
    return [torch.rand(1, 3, 8, 8, generator=g) for _ in range(3)]


def test_features_of_a_view_are_computed_once(images: list[Tensor]) -> None:
    loss = Counted()
    term = PerceptualTerm(loss, 1.0)
    for _ in range(3):
        for name, image in zip("abc", images, strict=True):
            term.of_target(name, image)
    assert loss.asked == 3


def test_numbers_do_not_depend_on_what_is_kept(images: list[Tensor]) -> None:
    one = sum(x.half().nbytes for x in Counted().features(images[0])) / 2**30
    kept, tight, none = (PerceptualTerm(Counted(), gib) for gib in (1.0, 1.5 * one, 0.0))
    for _ in range(2):
        for name, image in zip("abc", images, strict=True):
            expected = [x.half().float() for x in Counted().features(image)]
            for term in (kept, tight, none):
                for found, wanted in zip(term.of_target(name, image), expected, strict=True):
                    assert torch.equal(found, wanted)
    assert [term.loss.asked for term in (kept, tight, none)] == [3, 5, 6]
