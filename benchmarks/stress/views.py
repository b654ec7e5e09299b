"""Fewer photographs than hoped."""

from __future__ import annotations

from dataclasses import replace

from nmbg.evaluation.published import dtu_parts
from nmbg.scene import Scene, evenly
from stress.scenes import Random, Stress

# Fewer views are no capture.
LEAST = 5
# The block whose held-out views are judged, a share of the views.
JUDGED = 0.25


def thinned(scene: Scene, severity: float, random: Random) -> Scene:
    """One training view of so many stays, evenly over the capture; five at least."""
    kept = evenly(scene.train, max(LEAST, round(len(scene.train) / severity)))
    return replace(scene, views=tuple(v for v in scene.views if v.split == "test" or v in kept))


def without_block(scene: Scene, severity: float, random: Random) -> Scene:
    """No training view among this share of the views, in the middle of the capture."""
    gone = _middle(scene, severity)
    views = tuple(v for i, v in enumerate(scene.views) if v.split == "test" or i not in gone)
    return replace(scene, views=views)


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
