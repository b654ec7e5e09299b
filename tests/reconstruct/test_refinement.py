"""Refining surfaces that stand a little wrong before a row of cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from nmbg.cameras import Camera
from nmbg.images import write_image
from nmbg.mesh import Mesh, merge
from nmbg.reconstruct.depths import unproject
from nmbg.reconstruct.refinement import LEAST_VIEWS, MOST_VIEWS, SWEEPS, refine_geometry, views_for
from nmbg.scene import Scene, View
from nmbg.sight import look

FOCAL, DEPTH, RADIUS = 100.0, 4.0, 0.7
CENTRE = np.array([0.0, 0.0, 3.0])


def cameras(n: int = 9) -> list[Camera]:
    K = np.array([[FOCAL, 0, 48], [0, FOCAL, 36], [0, 0, 1]])
    places = [(x, 0.2 * (-1) ** i, 0.0) for i, x in enumerate(np.linspace(-0.8, 0.8, n))]
    return [Camera(K, np.eye(3), -np.array(place), 96, 72) for place in places]


def wall(z: Callable[[np.ndarray, np.ndarray], np.ndarray], n: int = 61) -> Mesh:
    """A square sheet at depth z(x, y), its normals towards the cameras."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-3, 3, n), np.linspace(-3, 3, n)))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + n, corner + 1], 1), np.stack([corner + 1, corner + n, corner + n + 1], 1)]
    )
    return grey(np.stack([x, y, z(x, y)], 1), faces)


def ball(radius: float) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return grey(sphere.vertices + CENTRE, sphere.faces)


def grey(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), np.full(vertices.shape, 128, np.uint8))


def flat(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.full_like(x, DEPTH)


def texture(points: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(points, -1, 0)
    waves = np.stack([np.sin(9 * x + z), np.sin(9 * y + 2 * z), np.sin(7 * (x + y) + 3 * z)], -1)
    return (127.5 + 100 * waves).round().astype(np.uint8)


@pytest.fixture
def scene_of(tmp_path: Path) -> Callable[..., Scene]:
    """A scene with photographs of one mesh and the geometry of another."""

    def build(world: Mesh, known: Mesh, shell: int = 0, n: int = 9) -> Scene:
        (tmp_path / "images").mkdir()
        views = []
        for i, camera in enumerate(cameras(n)):
            image = texture(unproject(camera, look(world, camera).depth))
            write_image(tmp_path / "images" / f"{i}.png", image)
            views.append(View(f"{i}.png", camera, "train", f"{i}.png", None))
        return Scene(tmp_path, known, shell, 0, tuple(views), CENTRE, 1.0, np.array([0, -1.0, 0]), 1, {}, "")

    return build


def test_a_dent_goes_back_to_the_wall(scene_of: Callable[..., Scene]) -> None:
    dented = wall(lambda x, y: DEPTH + 0.1 * np.exp(-3 * (x**2 + y**2)))
    refined = refine_geometry(scene_of(wall(flat), dented))
    assert np.array_equal(refined.faces, dented.faces)
    middle = np.linalg.norm(dented.vertices[:, :2], axis=1) < 0.6
    before = np.abs(dented.vertices[middle, 2] - DEPTH).mean()
    assert np.abs(refined.vertices[middle, 2] - DEPTH).mean() < 0.4 * before


def test_a_ball_that_is_too_small_grows_to_its_outline(scene_of: Callable[..., Scene]) -> None:
    behind = wall(flat)
    small = ball(0.97 * RADIUS)
    refined = refine_geometry(scene_of(merge(ball(RADIUS), behind), merge(small, behind)))
    radius = np.linalg.norm(refined.vertices[: len(small.vertices)] - CENTRE, axis=1)
    facing = small.vertices[:, 2] < CENTRE[2]  # the far side is seen by nobody
    assert np.abs(radius[facing] - RADIUS).mean() < 0.5 * 0.03 * RADIUS


def test_a_right_surface_stays(scene_of: Callable[..., Scene]) -> None:
    world = merge(ball(RADIUS), wall(flat))
    moved = np.linalg.norm(refine_geometry(scene_of(world, world)).vertices - world.vertices, axis=1)
    pixel = DEPTH / FOCAL
    assert np.quantile(moved, 0.95) < 0.3 * pixel


def test_the_shell_stays_where_it_is(scene_of: Callable[..., Scene]) -> None:
    shell = wall(lambda x, y: np.full_like(x, 1.02 * DEPTH))
    scene = scene_of(merge(ball(RADIUS), wall(flat)), merge(ball(0.97 * RADIUS), shell), len(shell.vertices))
    refined = refine_geometry(scene)
    n = len(shell.vertices)
    assert np.array_equal(refined.vertices[-n:], shell.vertices)
    assert not np.array_equal(refined.vertices[:-n], scene.mesh.vertices[:-n])


@pytest.mark.parametrize("case", ["one view", "nothing seen", "masked away"])
def test_without_evidence_nothing_moves(scene_of: Callable[..., Scene], case: str) -> None:
    dented = wall(lambda x, y: DEPTH + 0.1 * np.exp(-3 * (x**2 + y**2)))
    scene = scene_of(wall(flat), dented, n=1 if case == "one view" else 3)
    if case == "nothing seen":
        scene = replace(scene, mesh=replace(dented, vertices=dented.vertices * np.float32(-1)))
    if case == "masked away":
        (scene.folder / "masks").mkdir()
        write_image(scene.folder / "masks" / "m.png", np.zeros((72, 96), np.uint8))
        scene = replace(scene, views=tuple(replace(view, mask="m.png") for view in scene.views))
    assert np.array_equal(refine_geometry(scene).vertices, scene.mesh.vertices)


def test_refinement_does_not_depend_on_threads(scene_of: Callable[..., Scene]) -> None:
    scene = scene_of(wall(flat), wall(lambda x, y: DEPTH + 0.05 * np.cos(3 * x)))
    threads = torch.get_num_threads()
    try:
        refined = []
        for n in (1, 3):
            torch.set_num_threads(n)
            refined.append(refine_geometry(scene, SWEEPS[:1]).vertices)
    finally:
        torch.set_num_threads(threads)
    assert np.array_equal(*refined)


def test_short_budgets_have_fewer_views_judge() -> None:
    assert views_for(None) == views_for(15) == MOST_VIEWS
    assert views_for(0.01) == LEAST_VIEWS
    assert LEAST_VIEWS < views_for(1) < views_for(2) < MOST_VIEWS
