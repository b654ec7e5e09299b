"""How many photographs a scene needs."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import torch

from nmbg.capacity.judge import Judge
from nmbg.model.config import ModelConfig
from nmbg.model.cover import SourceCover, greedy_cover
from nmbg.model.renderer import Renderer
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View, evenly
from nmbg.sight import look
from nmbg.training.start import mean_colours

# What leaving out photographs may cost the views that judge, dB.
COST = 0.01
# So many training views judge, spread over the capture.
JUDGES = 32


def choose_photographs(
    scene: Scene, wish: int | Literal["auto", "all"], model: ModelConfig
) -> tuple[View, ...]:
    """The training photographs to keep, greedily by what each adds to how well training views are covered.

    Args:
        scene: the scene.
        wish: how many at most; "auto": as many as predict training views, which are themselves left out, as
            well as all do; "all".
        model: that blends them.

    Returns:
        a part of scene.train, in its order.
    """
    if wish == "all" or wish == len(scene.train):
        return scene.train
    order = _by_worth(scene, model.sources)
    kept = {view.name for view in order[: _enough(scene, order, model) if wish == "auto" else wish]}
    return tuple(view for view in scene.train if view.name in kept)


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
    chosen = greedy_cover(torch.cat(scores, 1), len(cameras), per_point)
    # Those that add nothing come last.
    chosen += sorted(set(range(len(cameras))) - set(chosen))
    return [scene.train[i] for i in chosen]


def _enough(scene: Scene, order: list[View], model: ModelConfig) -> int:
    """The least number of the first photographs that costs the judges no more than COST."""
    renderer = Renderer(replace(model, degree=0, widths=(), supersample=1), [scene.mesh])
    renderer.set_colours(mean_colours(renderer.layers))
    renderer.remember(scene, scene.train)
    judge = Judge(scene, evenly(scene.train, JUDGES))

    def psnr(count: int) -> float:
        dropped = {view.name for view in scene.train} - {view.name for view in order[:count]}
        return judge.psnr(lambda view: renderer.render(view.camera, without=dropped | {view.name}))

    # Fewer photographs show less: the number is found by halving.
    too_few, enough = 0, len(order)
    wanted = psnr(enough) - COST
    with progress_bar() as bar:
        task = bar.add_task("photographs needed", total=enough.bit_length())
        while enough - too_few > 1:
            middle = (too_few + enough) // 2
            too_few, enough = (too_few, middle) if psnr(middle) >= wanted else (middle, enough)
            bar.advance(task)
    return enough
