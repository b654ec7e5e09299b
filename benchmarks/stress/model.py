"""What a model that rasterizes points and faces does with one of the two."""

from __future__ import annotations

from dataclasses import replace

from nmbg.training.config import TrainConfig
from stress.scenes import Stress


def one_kind(config: TrainConfig, severity: float) -> TrainConfig:
    """0: both; 1: faces alone; 2: points alone."""
    points, faces = ((True, True), (False, True), (True, False))[round(severity)]
    return replace(config, model=replace(config.model, points=points, faces=faces))


MODEL = (
    Stress(
        "faces or points",
        "model",
        "1: faces only, 2: points only",
        (0, 1, 2),
        config=one_kind,
        presets=("paper",),
    ),
)
