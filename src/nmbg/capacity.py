"""How much memory a scene needs."""

from __future__ import annotations

from typing import Literal

import torch

from nmbg.model.cover import SourceCover, greedy_cover
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View
from nmbg.sight import look

# Photographs are added while each adds this share to what the ones before cover.
WORTH = 5e-4


def choose_photographs(scene: Scene, wish: int | Literal["auto", "all"], per_point: int) -> tuple[View, ...]:
    """The training photographs to keep, greedily by what each adds to how well the others' views are covered.

    Args:
        scene: the scene.
        wish: how many at most; "auto": while they add something; "all".
        per_point: photographs that are blended in a pixel.

    Returns:
        a part of scene.train, in its order.
    """
    if wish == "all" or wish == len(scene.train):
        return scene.train
    cameras = [view.camera for view in scene.train]
    cover = SourceCover(scene.mesh, cameras)
    scores = []
    with progress_bar() as bar:
        for i, camera in enumerate(bar.track(cameras, description="choosing photographs")):
            small = camera.within(96)
            points = cover.points(small, look(scene.mesh, small).depth)
            seen = cover.scores(points, torch.from_numpy(camera.centre)).float()
            seen[i] = 0  # a view must be covered by the others
            scores.append(seen)
    most, least = (len(cameras), WORTH) if wish == "auto" else (wish, 0.0)
    chosen = greedy_cover(torch.cat(scores, 1), most, per_point, least)
    return tuple(scene.train[i] for i in chosen)
