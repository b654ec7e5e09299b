"""Points that are missing at random in training steps."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.member import SEEN, Member, begin
from nmbg.training.views import Example

CONFIG = replace(PRESETS["npbg"], perceptual="none", iterations=6)


def points(example: Example) -> Tensor:
    assert isinstance(example.sight, list)
    index = example.sight[0].levels[0].index
    assert index is not None
    return index


@pytest.fixture
def member(scene_folder: Path, tmp_path: Path) -> Member:
    scene, config, renderer, fit = begin(Scene.load(scene_folder), CONFIG, tmp_path, None)
    return Member(tmp_path, scene, config, renderer, fit)


def test_every_step_hides_others_and_progress_figures_none(member: Member) -> None:
    member.steps = SEEN * len(member.training)
    whole = points(member.training.frame(0))
    first, second, again = (points(member.example(0, step)) for step in (1, 2, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, second)
    hidden = [int(((index < 0) & (whole >= 0)).sum()) for index in (first, second)]
    assert all(0 < count < 0.5 * int((whole >= 0).sum()) for count in hidden)
    assert torch.equal(points(member.training.frame(0)), whole)


def test_none_are_hidden_before_the_views_have_been_seen_a_few_times(member: Member) -> None:
    member.steps = SEEN * len(member.training) - 1
    assert torch.equal(points(member.example(0, 1)), points(member.training.frame(0)))


@pytest.mark.parametrize("share", [-0.1, 1.0, float("nan")])
def test_a_share_outside_its_range(share: float) -> None:
    with pytest.raises(ValueError, match="expected a share"):
        replace(CONFIG, hide_points=share)


def test_no_points_to_hide() -> None:
    with pytest.raises(ValueError, match="no points to hide"):
        replace(PRESETS["mesh"], hide_points=0.3)
