"""A run without a model: a scene on disk whose "renderer" shows the photographs with an error of choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nmbg.cameras import Camera
from nmbg.images import write_image
from nmbg.mesh import Mesh
from nmbg.scene import Scene, View
from nmbg.training.config import PRESETS

NAMES = ("a.jpg", "b.jpg", "sub/c.jpg", "d.jpg")


@dataclass
class FakeRenderer:
    """Shows the photograph whose camera it is given, plus `error`."""

    photos: dict[int, torch.Tensor]
    error: float = 0.1
    rendered: list[int] = field(default_factory=list)
    photographs: None = None

    def render(self, camera: Camera, without: str | None = None) -> torch.Tensor:
        self.rendered.append(id(camera))
        return (self.photos[id(camera)] + self.error).clamp(0, 1)


def make_scene(folder: Path, width: int, height: int, masks: bool, names: tuple[str, ...] = NAMES) -> Scene:
    """Smooth photographs between .2 and .8, the first two held out; masks keep the left half."""
    views = []
    for i, name in enumerate(names):
        camera = Camera(np.diag([50.0, 50.0, 1.0]), np.eye(3), np.array([0.0, 0.0, 2.0 + i]), width, height)
        ramp = np.linspace(51, 204, width)[None, :, None] * np.linspace(1, 1 - 0.1 * i, height)[:, None, None]
        for kind in ("images", "masks"):
            (folder / kind / name).parent.mkdir(parents=True, exist_ok=True)
        stored = Path(name).with_suffix(".png").as_posix()
        write_image(
            folder / "images" / stored, np.broadcast_to(ramp, (height, width, 3)).round().astype(np.uint8)
        )
        if masks:
            mask = np.zeros((height, width), dtype=np.uint8)
            mask[:, : width // 2] = 255
            write_image(folder / "masks" / stored, mask)
        split = "test" if i < 2 else "train"
        views.append(View(name, camera, split, stored, stored if masks else None))
    mesh = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.int32))
    return Scene(folder, mesh, 0, 0, tuple(views), np.zeros(3), 1.0, np.array([0.0, -1, 0]), 1, {}, "made up")


@pytest.fixture
def make_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., SimpleNamespace]:
    """Make a run folder that `evaluate` loads: .folder, .scene, .renderer."""

    def make(
        width: int = 48, height: int = 36, masks: bool = False, error: float = 0.1, **scene
    ) -> SimpleNamespace:
        made = make_scene(tmp_path / "scene", width, height, masks, **scene)
        photos = {
            id(v.camera): torch.from_numpy(made.load_image(v)).permute(2, 0, 1).float() / 255
            for v in made.views
        }
        folder = tmp_path / "run"
        folder.mkdir()
        run = SimpleNamespace(
            folder=folder,
            source=made.folder,
            scene=made,
            renderer=FakeRenderer(photos, error),
            config=PRESETS["mesh"],
        )
        monkeypatch.setattr("nmbg.evaluation.evaluate.load_run", lambda folder, device: run)
        monkeypatch.setattr("nmbg.evaluation.evaluate.load_views", lambda folder, scene: scene)
        monkeypatch.setattr(
            "nmbg.evaluation.evaluate.run_cost", lambda folder: {"train_seconds": 60.0, "megabytes": 1.5}
        )
        monkeypatch.setattr("nmbg.evaluation.report.feature_panels", lambda *_: [])
        monkeypatch.setattr(Scene, "load", lambda folder: made)
        return run

    return make
