from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmbg.capacity.photographs import choose_photographs
from nmbg.images import Image
from nmbg.scene import Scene, View
from nmbg.training.config import PRESETS

MODEL = replace(PRESETS["photos"].model, sources=3)


def test_all_and_numbers(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    assert choose_photographs(scene, "all", MODEL) == scene.train
    assert choose_photographs(scene, len(scene.train), MODEL) == scene.train
    three = choose_photographs(scene, 3, MODEL)
    assert len(three) == 3
    assert set(three) < set(scene.train)


def test_the_first_choice_is_seen_by_most_others(scene_folder: Path) -> None:
    """Seven cameras stand on a ring with a gap: the one to keep is none of those beside the gap."""
    scene = Scene.load(scene_folder)
    (kept,) = choose_photographs(scene, 1, replace(MODEL, sources=1))
    assert 0 < scene.train.index(kept) < len(scene.train) - 1


def test_auto_keeps_photographs_that_stand_alone(scene_folder: Path) -> None:
    """Forty degrees apart, each of them adds something."""
    scene = Scene.load(scene_folder)
    assert len(choose_photographs(scene, "auto", MODEL)) >= 5


def test_auto_drops_what_shows_nothing_new(scene_of_nine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs that show what the mesh shows anyway are not needed."""
    scene = Scene.load(scene_of_nine)
    grey = replace(scene.mesh, colours=np.full_like(scene.mesh.colours, 128))

    def plain(self: Scene, view: View) -> Image:
        return np.full((view.camera.height, view.camera.width, 3), 128, np.uint8)

    monkeypatch.setattr(Scene, "load_image", plain)
    assert len(choose_photographs(replace(scene, mesh=grey), "auto", MODEL)) == 1


def test_auto_keeps_what_a_single_view_needs(scene_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two neighbours show what no other photograph shows: each is needed by the other alone."""
    scene = Scene.load(scene_folder)
    grey = replace(scene.mesh, colours=np.full_like(scene.mesh.colours, 128))
    pair, load = scene.train[-2:], Scene.load_image

    def plain(self: Scene, view: View) -> Image:
        image = load(self, view)
        return image if view in pair else np.full_like(image, 128)

    monkeypatch.setattr(Scene, "load_image", plain)
    kept = choose_photographs(replace(scene, mesh=grey), "auto", MODEL)
    assert set(pair) <= set(kept)
