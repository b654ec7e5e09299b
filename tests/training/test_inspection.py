"""Photographs and poses that are wrong, one at a time, in a generated capture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmbg.cameras import Camera
from nmbg.demo.capture import CaptureConfig, make_capture
from nmbg.images import Image
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene, View
from nmbg.training.config import PRESETS
from nmbg.training.inspection import doubtful
from nmbg.training.run_views import load_views
from nmbg.training.trainer import resume, train


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("inspection")
    make_capture(folder / "capture", CaptureConfig(views=20, width=160, height=120, samples=1, points=300))
    return preprocess(folder / "capture", folder / "scene", PreprocessOptions(background="shell"))


def elsewhere(scene: Scene, i: int, camera: Camera) -> Scene:
    """The scene with another camera for training view i."""
    name = scene.train[i].name
    return replace(
        scene, views=tuple(replace(v, camera=camera) if v.name == name else v for v in scene.views)
    )


def test_a_sound_capture_keeps_every_view(scene: Scene) -> None:
    assert doubtful(scene) == {}


def test_a_dark_photograph_is_kept(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    load, dark = Scene.load_image, scene.train[5].name

    def dimmed(self: Scene, view: View) -> Image:
        image = load(self, view)
        return (image * 0.4).astype(np.uint8) if view.name == dark else image

    monkeypatch.setattr(Scene, "load_image", dimmed)
    assert doubtful(scene) == {}


@pytest.mark.parametrize("fault", ["black", "other"])
def test_a_wrong_photograph_is_named(scene: Scene, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    load = Scene.load_image
    wrong, other = scene.train[5].name, scene.train[11]

    def spoiled(self: Scene, view: View) -> Image:
        if view.name != wrong:
            return load(self, view)
        return np.zeros_like(load(self, view)) if fault == "black" else load(self, other)

    monkeypatch.setattr(Scene, "load_image", spoiled)
    assert list(doubtful(scene)) == [wrong]
    assert "little in common" in doubtful(scene)[wrong]


def test_a_pose_that_is_wildly_wrong_is_named(scene: Scene) -> None:
    camera = replace(scene.train[11].camera, K=scene.train[5].camera.K)
    assert list(doubtful(elsewhere(scene, 5, camera))) == [scene.train[5].name]


def test_a_view_that_sees_no_surface_is_named(scene: Scene) -> None:
    camera = scene.train[5].camera
    away = replace(camera, t=camera.t + np.array([0, 0, -1e4]))  # everything lies behind it
    found = doubtful(elsewhere(scene, 5, away))
    assert list(found) == [scene.train[5].name]
    assert "no surface" in found[scene.train[5].name]


def test_few_views_are_all_kept(scene: Scene) -> None:
    few = replace(scene, views=scene.train[:5])
    camera = few.train[0].camera
    assert doubtful(elsewhere(few, 0, replace(camera, t=camera.t + np.array([0, 0, -1e4])))) == {}


def test_training_goes_on_without_them_and_says_so(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = scene.train[5].camera
    bad = elsewhere(scene, 5, replace(camera, t=camera.t + np.array([0, 0, -1e4])))
    (tmp_path / "scene").mkdir()
    bad.save(tmp_path / "scene")
    (tmp_path / "scene" / "images").symlink_to(scene.folder / "images")
    bad = Scene.load(tmp_path / "scene")
    config = replace(PRESETS["photos-mesh"], minutes=None, iterations=3)
    run = train(bad, config, tmp_path / "run")
    name = scene.train[5].name
    assert f"{name} is left out" in capsys.readouterr().err.replace("\n", " ")
    assert name not in {view.name for view in Scene.load(run / "scene").views}
    assert name not in {view.name for view in load_views(run, bad).views}
    content = (run / "config.yaml").read_text().replace("iterations: 3", "iterations: 5")
    (run / "config.yaml").write_text(content)
    resume(run)
    kept = train(bad, replace(config, inspect=False), tmp_path / "kept")
    assert name in {view.name for view in Scene.load(kept / "scene").views}
