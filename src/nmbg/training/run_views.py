"""The training views as a run has them, views.json: which, where, and how their photographs are exposed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from nmbg.atomic import atomic_file
from nmbg.cameras import Camera
from nmbg.errors import NmbgError
from nmbg.model.exposure import Exposure, Exposures
from nmbg.scene import Scene, View, camera_from_record, camera_record

VIEWS = "views.json"

T = TypeVar("T")


def save_views(
    run: Path, scene: Scene, left_out: Mapping[str, str], exposures: Exposures | None = None
) -> None:
    """Write views.json.

    Args:
        run: run folder.
        scene: gives the training views, at their places in the run.
        left_out: views that the run leaves out, and why.
        exposures: of training photographs, where the run takes them into account.
    """
    content: dict[str, Any] = {
        "left_out": dict(left_out),
        "cameras": {view.name: camera_record(view.camera) for view in scene.train},
        "exposures": None,
    }
    if exposures is not None:
        content["exposures"] = {
            name: {part: value.flatten().tolist() for part, value in exposure._asdict().items()}
            for name, exposure in zip(exposures.names, exposures.values, strict=True)
        }
    with atomic_file(run / VIEWS) as path:
        path.write_text(json.dumps(content, indent=1) + "\n")


def load_views(run: Path, scene: Scene) -> Scene:
    """A scene with the training views that a run has, at their places in the run.

    Raises:
        NmbgError: the file is missing or damaged, or belongs to another scene.
    """

    def placed(content: Any) -> tuple[View, ...]:
        views = []
        for view in scene.views:
            if view.split == "train" and view.name not in content["left_out"]:
                camera = camera_from_record(content["cameras"][view.name])
                views.append(replace(view, camera=replace(view.camera, R=camera.R, t=camera.t)))
            elif view.split == "test":
                views.append(view)
        return tuple(views)

    return replace(scene, views=_parsed(run, placed))


def load_cameras(run: Path) -> list[Camera]:
    """Cameras of the training views that a run has, in the scene's order.

    Raises:
        NmbgError: the file is missing or damaged.
    """
    return _parsed(
        run, lambda content: [camera_from_record(record) for record in content["cameras"].values()]
    )


def load_exposures(run: Path) -> Exposures | None:
    """The exposures of training photographs that a run takes into account, if it does.

    Raises:
        NmbgError: the file is missing or damaged.
    """

    def exposures(content: Any) -> Exposures | None:
        found = content["exposures"]
        if found is None:
            return None
        centres = [camera_from_record(content["cameras"][name]).centre for name in found]
        values = [
            Exposure(*(torch.tensor(found[name][part])[:, None, None] for part in ("gain", "offset")))
            for name in found
        ]
        return Exposures(tuple(found), np.stack(centres), tuple(values))

    return _parsed(run, exposures)


def _parsed(run: Path, parse: Callable[[Any], T]) -> T:
    path = run / VIEWS
    try:
        return parse(json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise NmbgError(f"{path}: damaged, or of another scene; train the run anew") from error
