"""Exposures of training photographs: told apart where those around a photograph say how it was exposed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nmbg.images import Image
from nmbg.reconstruct.prediction import shade
from nmbg.scene import Scene, View
from nmbg.training import checkpoint
from nmbg.training.config import PRESETS, TrainConfig
from nmbg.training.exposures import find_exposures
from nmbg.training.run_views import load_exposures
from nmbg.training.trainer import train

CONFIG: TrainConfig = replace(
    PRESETS["mesh"], minutes=None, iterations=0, start="mean", validation_views=0, inspect=False
)


def row(scene: Scene, monkeypatch: pytest.MonkeyPatch, gains: Sequence[float]) -> Scene:
    """Cameras beside one another, whose photographs show the mesh, each times its gain."""
    first = scene.train[0]
    gain, views = {}, []
    for i, share in enumerate(gains):
        camera = replace(first.camera, t=first.camera.t + np.array([0.02 * i, 0, 0]))
        views.append(replace(first, name=f"{i:02}.png", camera=camera))
        gain[views[-1].name] = share

    def load(self: Scene, view: View) -> Image:
        return (gain[view.name] * shade(scene.mesh, view.camera)[0].numpy()).astype(np.uint8)

    monkeypatch.setattr(Scene, "load_image", load)
    return replace(scene, views=tuple(views))


DRIFT = np.linspace(1, 0.5, 12).tolist()


def test_drifting_exposures_are_told_apart(scene_of_nine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = row(Scene.load(scene_of_nine), monkeypatch, DRIFT)
    found = find_exposures(scene, scene.train)
    assert found is not None
    gains = [float(exposure.gain.mean()) for exposure in found.values]
    np.testing.assert_allclose(gains, DRIFT, atol=0.03)


@pytest.mark.parametrize("gains", [[0.7] * 12, [*[1.0] * 5, 0.6, *[1.0] * 6], [0.9]])
def test_what_all_share_or_one_alone_has_is_no_difference(
    scene_of_nine: Path, monkeypatch: pytest.MonkeyPatch, gains: list[float]
) -> None:
    scene = row(Scene.load(scene_of_nine), monkeypatch, gains)
    assert find_exposures(scene, scene.train) is None


def test_a_run_renders_as_the_photographs_around_were_exposed(
    scene_of_nine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = row(Scene.load(scene_of_nine), monkeypatch, DRIFT)
    run = train(scene, replace(CONFIG, exposure=True), tmp_path / "exposed")
    exposures = load_exposures(run)
    assert exposures is not None
    renderer = checkpoint.load_run(run).renderer
    plain = checkpoint.load_run(train(scene, CONFIG, tmp_path / "plain")).renderer
    view = scene.train[2]
    expected = exposures.around(view.camera.centre, {view.name}).apply(plain.render(view.camera))
    torch.testing.assert_close(renderer.render(view.camera, {view.name}), expected.clamp(0, 1))


def test_photographs_that_are_blended_are_exposed_alike_already() -> None:
    with pytest.raises(ValueError, match="exposed alike already"):
        replace(PRESETS["nmbg"], exposure=True)
