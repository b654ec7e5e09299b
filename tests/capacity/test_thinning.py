from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from nmbg.capacity.judge import Limit
from nmbg.capacity.plan import plan
from nmbg.capacity.thinning import OPENED, covered, halved, opened
from nmbg.mesh import Mesh, drop_unused, merge
from nmbg.scene import Scene
from nmbg.sight import look
from nmbg.training.config import PRESETS

PHOTOS = replace(PRESETS["photos"], capacity="auto")


def subdivided(scene: Scene, times: int) -> Scene:
    """The same surface in 4ᵗⁱᵐᵉˢ as many faces."""
    vertices, faces, colours = scene.mesh.vertices, scene.mesh.faces, {"colours": scene.mesh.colours}
    for _ in range(times):
        vertices, faces, colours = trimesh.remesh.subdivide(vertices, faces, vertex_attributes=colours)
    shown = colours["colours"].round().astype(np.uint8)
    fine = Mesh(vertices.astype(np.float32), faces.astype(np.int32), shown)
    return replace(scene, mesh=fine, shell_vertices=0, shell_faces=0)


def test_half_of_the_faces_lie_on_the_same_surface(scene_folder: Path) -> None:
    scene = subdivided(Scene.load(scene_folder), 1)
    less = halved(scene)
    assert abs(len(less.mesh.faces) - len(scene.mesh.faces) // 2) <= 2
    surface = trimesh.Trimesh(scene.mesh.vertices, scene.mesh.faces, process=False)
    distance, _ = cKDTree(surface.vertices).query(less.mesh.vertices)
    assert np.median(distance) < 0.25 * surface.edges_unique_length.mean()


def test_the_shell_stays_as_it_is(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=30)
    shell = Mesh(
        sphere.vertices.astype(np.float32),
        sphere.faces.astype(np.int32),
        np.zeros((len(sphere.vertices), 3), np.uint8),
    )
    n, m = len(shell.vertices), len(shell.faces)
    less = halved(replace(scene, mesh=merge(scene.mesh, shell), shell_vertices=n, shell_faces=m)).mesh
    assert np.array_equal(less.vertices[-n:], shell.vertices)
    assert np.array_equal(less.faces[-m:] - (len(less.vertices) - n), shell.faces)
    assert less.faces[:-m].max() < len(less.vertices) - n


def test_faces_that_no_pixel_resolves_go(scene_folder: Path) -> None:
    coarse = Scene.load(scene_folder)
    for _ in range(3):
        coarse = halved(coarse)
    fine = subdivided(coarse, 2)
    planned = plan(fine, PHOTOS)
    assert len(planned.scene.mesh.faces) < 0.6 * len(fine.mesh.faces)
    (told,) = (choice for choice in planned.config.choices if choice.choice.startswith("faces:"))
    assert told.choice.startswith(f"faces: {len(planned.scene.mesh.faces)} of ")


def without_window(scene: Scene) -> Scene:
    """Without the faces that stand in the middle of what the first view sees."""
    camera = scene.train[0].camera
    h = camera.project(torch.from_numpy(scene.mesh.vertices[scene.mesh.faces].mean(1))).numpy()
    x, y = (h[:, :2] / h[:, 2:]).T
    inside = (abs(x - camera.width / 2) < 4) & (abs(y - camera.height / 2) < 4) & (h[:, 2] > 0)
    return replace(scene, mesh=drop_unused(scene.mesh, ~inside))


def test_only_the_surface_covers(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    assert scene.shell_faces
    surface = np.arange(len(scene.mesh.faces)) < len(scene.mesh.faces) - scene.shell_faces
    bare = drop_unused(scene.mesh, surface)
    for view in scene.train:
        assert torch.equal(covered(scene, view), look(bare, view.camera).covered)
        assert not covered(scene, view).all()


def test_halving_stops_where_it_opens_a_hole(scene_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However little it costs."""
    scene = subdivided(Scene.load(scene_folder), 2)
    assert opened(scene, halved(scene), scene.train) <= OPENED
    assert opened(scene, without_window(scene), scene.train) > 0.01
    monkeypatch.setattr("nmbg.capacity.plan.halved", without_window)
    monkeypatch.setattr("nmbg.capacity.plan.THINNING_LIMIT", Limit(100.0, 100.0))
    planned = plan(scene, PHOTOS)
    (told,) = (choice for choice in planned.config.choices if choice.choice.startswith("faces:"))
    assert "opens" in told.reason
    assert told.saves == "nothing"
