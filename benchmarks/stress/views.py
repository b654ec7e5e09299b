"""Fewer photographs than hoped."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from nmbg.cameras import Camera
from nmbg.evaluation.published import dtu_parts
from nmbg.images import Image, Mask
from nmbg.reconstruct.colours import mean_vertex_colours, spread
from nmbg.scene import Scene, View, evenly
from stress.scenes import Random, Stress

# Fewer views are no capture.
LEAST = 5
# The block whose held-out views are judged, a share of the views.
JUDGED = 0.25


def thinned(scene: Scene, severity: float, random: Random) -> Scene:
    """One training view of so many stays, evenly over the capture; five at least."""
    return seen_by(scene, evenly(scene.train, max(LEAST, round(len(scene.train) / severity))))


def without_block(scene: Scene, severity: float, random: Random) -> Scene:
    """No training view among this share of the views, in the middle of the capture."""
    gone = _middle(scene, severity)
    return seen_by(scene, [v for i, v in enumerate(scene.views) if v.split == "train" and i not in gone])


def seen_by(scene: Scene, kept: Sequence[View]) -> Scene:
    """The scene with these training views, in the colours that they show.

    What only the others saw is coloured as what lies beside it; what none of them saw stays as it was.
    """
    if len(kept) == len(scene.train):
        return scene
    mesh = scene.mesh
    _, before = mean_vertex_colours(mesh, _photographs(scene, scene.train))
    colours, seen = mean_vertex_colours(mesh, _photographs(scene, kept))
    colours[~before] = mesh.colours[~before]
    colours = spread(colours, seen | ~before, mesh.faces).round().clip(0, 255).astype(np.uint8)
    views = tuple(view for view in scene.views if view.split == "test" or view in kept)
    return replace(scene, views=views, mesh=replace(mesh, colours=colours))


def _photographs(scene: Scene, views: Sequence[View]) -> Iterator[tuple[Camera, Image, Mask | None]]:
    for view in views:
        yield view.camera, scene.load_image(view), scene.load_mask(view)


def beyond_the_cameras(scene: Scene, severity: float) -> tuple[str, ...]:
    """Views between the training cameras, or beyond them, where DTU's views were held out."""
    parts = dtu_parts(scene)
    return list(parts.values())[int(severity)] if parts else ()


def in_block(scene: Scene, severity: float) -> tuple[str, ...]:
    """Held-out views in the middle of the capture."""
    middle = _middle(scene, JUDGED)
    return tuple(v.name for i, v in enumerate(scene.views) if v.split == "test" and i in middle)


def _middle(scene: Scene, share: float) -> range:
    n = len(scene.views)
    return range(round((1 - share) / 2 * n), round((1 + share) / 2 * n))


VIEWS = (
    Stress("fewer views", "views", "training views divided by", (1, 2, 4, 8), thinned),
    Stress("block", "views", "share of the capture without views", (0, 0.25, 0.5, 0.75), without_block,
           judged=in_block),
    Stress("beyond", "views", "0 between, 1 beyond the training cameras", (0, 1), judged=beyond_the_cameras),
)  # fmt: skip
