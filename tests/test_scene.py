from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmbg.errors import NmbgError
from nmbg.images import write_image
from nmbg.scene import Scene


@pytest.fixture
def own_scene(scene_folder: Path, tmp_path: Path) -> Path:
    """A copy of the scene that a test may damage."""
    return Path(shutil.copytree(scene_folder, tmp_path / "scene"))


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    record = json.loads((folder / "scene.json").read_text())
    change(record)
    (folder / "scene.json").write_text(json.dumps(record))


def test_loading_what_was_saved_gives_the_same_numbers(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    scene.save(tmp_path)
    again = Scene.load(tmp_path)
    for name in ("vertices", "faces", "colours"):
        assert np.array_equal(getattr(again.mesh, name), getattr(scene.mesh, name))
    for a, b in zip(again.views, scene.views, strict=True):
        assert (a.name, a.split, a.image, a.mask) == (b.name, b.split, b.image, b.mask)
        for name in ("K", "R", "t"):
            assert np.array_equal(getattr(a.camera, name), getattr(b.camera, name))
    assert np.array_equal(again.centre, scene.centre)
    assert np.array_equal(again.up, scene.up)
    assert (again.radius, again.layers, again.summary) == (scene.radius, scene.layers, scene.summary)
    assert (again.shell_vertices, again.shell_faces) == (scene.shell_vertices, scene.shell_faces)


def test_views_are_sorted_and_split(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    assert [view.name for view in scene.views] == [f"{i:03d}.png" for i in range(14)]
    assert [view.name for view in scene.test] == ["000.png", "008.png"]
    assert len(scene.train) == 12
    assert scene.load_image(scene.views[0]).shape == (48, 64, 3)
    assert scene.load_mask(scene.views[0]) is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.update(version=99), "version 99, this program reads version 1"),
        (lambda r: r.pop("version"), "damaged or not a scene"),
        (lambda r: r.pop("views"), "incomplete or damaged"),
        (lambda r: r["views"][0].update(K=[[1, 2], [3, 4]]), "expected shape"),
        (lambda r: r["views"][0].update(split="validation"), "validation"),
        (lambda r: r["shell"].update(faces=10**9), "does not belong to the geometry"),
    ],
)
def test_foreign_scenes_are_refused(
    change: Callable[[dict[str, Any]], object], message: str, own_scene: Path
) -> None:
    edit(own_scene, change)
    with pytest.raises(NmbgError, match=message) as caught:
        Scene.load(own_scene)
    assert "scene.json" in str(caught.value)
    assert "preprocess" in str(caught.value)


def test_text_that_is_no_json_is_refused(own_scene: Path) -> None:
    (own_scene / "scene.json").write_text("{")
    with pytest.raises(NmbgError, match="damaged or not a scene"):
        Scene.load(own_scene)


def test_a_folder_without_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="not a scene folder"):
        Scene.load(tmp_path)


def test_a_scene_without_geometry_is_refused(own_scene: Path) -> None:
    (own_scene / "geometry.ply").unlink()
    with pytest.raises(NmbgError, match=r"geometry\.ply"):
        Scene.load(own_scene)


def test_an_image_of_another_size_is_refused_when_it_is_read(own_scene: Path) -> None:
    scene = Scene.load(own_scene)
    write_image(own_scene / "images" / scene.views[0].image, np.zeros((5, 7, 3), np.uint8))
    with pytest.raises(NmbgError, match=r"7×5 pixels, scene\.json says 64×48"):
        scene.load_image(scene.views[0])
