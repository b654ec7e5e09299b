"""Scenes with fewer vertices or smaller training photographs."""

from pathlib import Path

import numpy as np
import pytest
from smaller import smaller_scene

from nmbg.images import read_image
from nmbg.scene import Scene


def test_training_photographs_shrink_and_held_out_ones_stay(scene_folder: Path, tmp_path: Path) -> None:
    scene, small = Scene.load(scene_folder), Scene.load(smaller_scene(scene_folder, tmp_path, images=0.5))
    for view, less in zip(scene.views, small.views, strict=True):
        factor = 2 if view.split == "train" else 1
        assert (less.camera.width, less.camera.height) == (
            view.camera.width // factor,
            view.camera.height // factor,
        )
        assert small.load_image(less).shape == (less.camera.height, less.camera.width, 3)
        np.testing.assert_allclose(factor * less.camera.K[:2], view.camera.K[:2])
    held_out = scene.test[0].image
    np.testing.assert_array_equal(
        read_image(small.folder / "images" / held_out), read_image(scene_folder / "images" / held_out)
    )


def test_the_surface_is_thinned_and_the_shell_stays(scene_folder: Path, tmp_path: Path) -> None:
    scene, small = Scene.load(scene_folder), Scene.load(smaller_scene(scene_folder, tmp_path, vertices=0.25))
    before, after = (len(s.mesh.vertices) - s.shell_vertices for s in (scene, small))
    assert before / 4 <= after < before / 2
    assert small.shell_vertices == scene.shell_vertices
    assert small.mesh.faces.max() < len(small.mesh.vertices)
    if scene.shell_faces:
        np.testing.assert_array_equal(
            small.mesh.vertices[small.mesh.faces[-scene.shell_faces :]],
            scene.mesh.vertices[scene.mesh.faces[-scene.shell_faces :]],
        )


def test_what_is_there_is_kept(scene_folder: Path, tmp_path: Path) -> None:
    assert smaller_scene(scene_folder, tmp_path) == scene_folder
    first = smaller_scene(scene_folder, tmp_path, images=0.5)
    (first / "mark").touch()
    assert (smaller_scene(scene_folder, tmp_path, images=0.5) / "mark").exists()


@pytest.mark.parametrize("share", [0.9, 0.1])
def test_no_face_is_left_without_area_in_the_grid(scene_folder: Path, tmp_path: Path, share: float) -> None:
    faces = Scene.load(smaller_scene(scene_folder, tmp_path, vertices=share)).mesh.faces
    assert (faces != np.roll(faces, 1, axis=1)).all()
