from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nmbg.model.cover import SourceCover, greedy_cover
from nmbg.scene import Scene
from nmbg.sight import look


def covered(scores: torch.Tensor, chosen: list[int], per_point: int) -> float:
    best = torch.cat([scores[chosen], scores.new_zeros(per_point, scores.shape[1])])
    return float(best.sort(0, descending=True).values[:per_point].sum())


@given(seed=st.integers(0, 10_000), most=st.integers(1, 6), per_point=st.integers(1, 3))
def test_greedy_is_near_the_best_choice(seed: int, most: int, per_point: int) -> None:
    """The gain of a greedy choice is at least 1 − 1/e of the best one's; one at a time it is the best."""
    from itertools import combinations

    scores = torch.rand(6, 9, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    chosen = greedy_cover(scores, most, per_point)
    assert len(chosen) == len(set(chosen))
    assert len(chosen) <= most
    best = max(covered(scores, list(c), per_point) for c in combinations(range(6), most))
    assert covered(scores, chosen, per_point) >= (1 if most == 1 else 0.63) * best - 1e-9


def test_what_adds_nothing_is_not_chosen() -> None:
    scores = torch.tensor([[1.0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0.1, 0]])
    assert greedy_cover(scores, 4, 1) == [0, 3]


def test_a_cover_beats_the_nearest_where_they_see_one_side() -> None:
    """Two near sources see the left half, a far one the right: of two, the far one is chosen too."""
    scores = torch.tensor([[0.9, 0.9, 0.0, 0.0], [0.8, 0.8, 0.0, 0.0], [0.0, 0.0, 0.2, 0.2]])
    assert greedy_cover(scores, 2, 1) == [0, 2]


def test_choice_contains_the_view_itself_and_honours_what_is_left_out(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    cover = SourceCover(scene.mesh, [view.camera for view in scene.train])
    for i, view in enumerate(scene.train):
        depth = look(scene.mesh, view.camera).depth
        assert i in cover.choose(view.camera, depth, 3, 2)
        assert i not in cover.choose(view.camera, depth, 3, 2, left_out=[i])


def test_scores_are_those_of_the_angle_where_seen(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    cameras = [view.camera for view in scene.train]
    cover = SourceCover(scene.mesh, cameras)
    top = torch.tensor([[0.0, 0.0, 1.6]], dtype=torch.float64)  # of the ball: every camera sees it
    under = torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)  # below the ground: none does
    centre = torch.from_numpy(cameras[0].centre)
    scores = cover.scores(torch.cat([top, under]), centre)
    assert scores[0, 0] == pytest.approx(1, abs=1e-6)
    assert (scores[:, 1] == 0).all()
    assert (scores[1:, 0] < 0.05).all()
