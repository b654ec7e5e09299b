"""How many photographs a scene needs."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import torch
from scipy.spatial.distance import cdist
from torch import Tensor

from nmbg.capacity.judge import Judge, Limit, Score
from nmbg.model.config import ModelConfig
from nmbg.model.cover import SourceCover, greedy_cover
from nmbg.model.photographs import NOTHING
from nmbg.model.renderer import Renderer
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View, evenly
from nmbg.sight import look
from nmbg.training.start import mean_colours

# What leaving out photographs may cost a view; a mean over views would hide what a few of them lose.
COST = Limit(0.05, 0.01)
# So many points of all views that should be covered, at most.
POINTS = 20_000
# Of those that would go, and of so many that stand nearest to each, so many judge at most.
NEAREST, JUDGES = 3, 32


def choose_photographs(
    scene: Scene, wish: int | Literal["auto", "all"], model: ModelConfig
) -> tuple[View, ...]:
    """The training photographs to keep, greedily by what each adds to how well training views are covered.

    Args:
        scene: the scene.
        wish: how many at most; "auto": as many as predict each training view, itself left out, as well as all
            do; "all".
        model: that blends them.

    Returns:
        a part of scene.train, in its order.
    """
    if wish == "all" or wish == len(scene.train):
        return scene.train
    order = _by_worth(scene, model.sources)
    kept = {view.name for view in order[: _enough(scene, order, model) if wish == "auto" else wish]}
    return tuple(view for view in scene.train if view.name in kept)


def blending(model: ModelConfig, scene: Scene, views: Sequence[View], colours: Sequence[Tensor]) -> Renderer:
    """Photographs of a scene blended over colours [N, B, 3] of its mesh, without a network."""
    renderer = Renderer(replace(model, widths=()), [scene.mesh])
    renderer.set_colours(colours)
    renderer.remember(scene, views)
    return renderer


def _by_worth(scene: Scene, per_point: int) -> list[View]:
    """Training views, what adds most to the coverage of all first; what others can replace comes last."""
    cameras = [view.camera for view in scene.train]
    cover = SourceCover(scene.mesh, cameras)
    scores = []
    with progress_bar() as bar:
        for camera in bar.track(cameras, description="choosing photographs"):
            small = camera.within(96)
            points = cover.points(small, look(scene.mesh, small).depth)
            scores.append(cover.scores(points, torch.from_numpy(camera.centre)).float())
    points_of_all = torch.cat(scores, 1)
    chosen = greedy_cover(points_of_all[:, :: 1 + points_of_all.shape[1] // POINTS], len(cameras), per_point)
    # Those that add nothing come last.
    chosen += sorted(set(range(len(cameras))) - set(chosen))
    return [scene.train[i] for i in chosen]


def _enough(scene: Scene, order: list[View], model: ModelConfig) -> int:
    """The least number of the first photographs without whose rest no judging view loses more than COST.

    Those that would go judge, and those nearest to them: each is predicted without its own photograph, as
    held-out views are, and what it loses is what was shown by photographs that would go.
    """
    coarse = replace(model, degree=0, supersample=1)
    renderer = blending(coarse, scene, scene.train, mean_colours([scene.mesh]))
    centres = np.stack([view.camera.centre for view in order])

    judge = cache(lambda view: Judge(scene, [view]))

    def score(view: View, without: Set[str] = NOTHING) -> Score:
        return judge(view).score(lambda v: renderer.render(v.camera, without=without | {v.name}))

    of_all = cache(score)

    def suffice(count: int) -> bool:
        near = cdist(centres[count:], centres).argsort(1)[:, : 1 + NEAREST]
        judges = evenly([order[i] for i in np.unique(near)], JUDGES)
        rest = {view.name for view in order[count:]}
        return all(score(view, rest).within(of_all(view), COST) for view in judges)

    # Fewer photographs show less: steps from all of them double until too few are left, then halve.
    too_few, enough, step = 0, len(order), 1
    with progress_bar() as bar:
        bar.add_task("photographs needed", total=None)
        while enough - too_few > 1:
            count = max(too_few + 1, enough - step)
            if suffice(count):
                enough, step = count, 2 * step
            else:
                too_few, step = count, max(1, (enough - count) // 2)
    return enough
