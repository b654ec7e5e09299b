"""Closing holes of a textured wall (and what stands before it), seen by a row of cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from nmbg.cameras import Camera
from nmbg.mesh import Mesh, drop_unused, empty_mesh, merge
from nmbg.reconstruct import background
from nmbg.reconstruct.background import best_background, make_background
from nmbg.reconstruct.completion import close_holes
from nmbg.reconstruct.depths import unproject
from nmbg.reconstruct.gallery import Gallery
from nmbg.reconstruct.judgement import left_out, score
from nmbg.sight import look

DEPTH = 4.0


def camera(x: float, y: float = 0.0) -> Camera:
    """Looks along +z from (x, y, 0) at 96×72 pixels."""
    K = np.array([[80.0, 0, 48], [0, 80.0, 36], [0, 0, 1]])
    return Camera(K, np.eye(3), -np.array([x, y, 0.0]), 96, 72)


def row(n: int = 9) -> list[Camera]:
    return [camera(x, 0.2 * (-1) ** i) for i, x in enumerate(np.linspace(-1, 1, n))]


def plate(z: float, half: float, n: int = 41, centre: tuple[float, float] = (0.0, 0.0)) -> Mesh:
    """A square at depth z, facing the cameras."""
    x, y = np.meshgrid(np.linspace(-half, half, n), np.linspace(-half, half, n))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + n], 1), np.stack([corner + 1, corner + n + 1, corner + n], 1)]
    )
    vertices = np.stack([x.ravel() + centre[0], y.ravel() + centre[1], np.full(n * n, z)], 1)
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), np.zeros((n * n, 3), np.uint8))


def pierced(mesh: Mesh, half: float, centre: tuple[float, float] = (0.0, 0.0)) -> Mesh:
    """A plate without the faces whose centroids lie in a square."""
    middle = mesh.vertices[mesh.faces].mean(1)[:, :2] - centre
    return drop_unused(mesh, np.abs(middle).max(1) > half)


def texture(points: np.ndarray) -> np.ndarray:
    """Colours [..., 3] uint8 of world points; waves as long as some ten pixels."""
    x, y, z = np.moveaxis(points, -1, 0)
    waves = np.stack([np.sin(7 * x + z), np.sin(7 * y + 2 * z), np.sin(5 * (x + y) + 3 * z)], -1)
    return (127.5 + 100 * waves).round().astype(np.uint8)


def photograph(world: Mesh, camera: Camera) -> np.ndarray:
    """What a camera sees of the textured world before a black nothing."""
    sight = look(world, camera)
    return np.where(sight.covered.numpy()[..., None], texture(unproject(camera, sight.depth)), 0).astype(
        np.uint8
    )


def gallery(world: Mesh, known: Mesh, cameras: list[Camera]) -> Gallery:
    """Photographs of the world with the depth of what is known of it."""
    return Gallery.hang(
        [look(known, camera) for camera in cameras],
        [photograph(world, camera) for camera in cameras],
        [np.ones((camera.height, camera.width), bool) for camera in cameras],
    )


WALL = plate(DEPTH, 5.0)


def test_a_hole_in_a_wall_is_closed_where_the_wall_was() -> None:
    known = pierced(WALL, 0.6)
    patches = close_holes(gallery(WALL, known, row()))
    assert np.abs(patches.vertices[:, 2] / DEPTH - 1).max() < 0.02
    for view in row():
        assert not look(known, view).covered.all()
        assert look(merge(known, patches), view).covered.all()


def test_what_the_mesh_shows_stays_in_front() -> None:
    known = pierced(WALL, 0.6)
    patches = close_holes(gallery(WALL, known, row()))
    for view in row():
        alone, together = look(known, view), look(merge(known, patches), view)
        hidden = alone.covered & (together.depth < 0.99 * alone.depth)
        assert not hidden.any()


def test_a_hole_beside_something_near_is_closed_behind_it() -> None:
    """The plate hides the wall's hole in part: what shows beside it is wall, not plate."""
    near = plate(2.0, 0.3)
    known = merge(pierced(WALL, 0.8), near)
    patches = close_holes(gallery(merge(WALL, near), known, row()))
    assert len(patches.faces)
    assert (patches.vertices[:, 2] > 0.9 * DEPTH).mean() > 0.9
    open_ = [gallery(WALL, merge(known, patches), [view]).open(0).float().mean() for view in row()]
    assert np.mean(open_) < 0.01


def test_no_patch_stands_in_front_of_what_another_view_sees() -> None:
    """A pillar that one half of the cameras sees past: the depth around the hole must not close the way."""
    deep = merge(pierced(plate(2.5, 5.0), 0.5), plate(6.0, 9.0))
    cameras = row()
    known = drop_unused(deep, np.ones(len(deep.faces), bool))
    hung = gallery(deep, known, cameras)
    blind = Gallery(  # the first view does not know what lies behind the window
        hung.cameras,
        hung.images,
        hung.inside,
        torch.where((torch.arange(len(hung)) == 0)[:, None, None] & (hung.depth > 3), torch.inf, hung.depth),
    )
    patches = close_holes(blind)
    found = hung.look_up(torch.from_numpy(patches.vertices))
    in_front = found.inside & (found.z < 0.95 * found.surface)
    assert not in_front[1:].any()


def test_patches_lie_beside_each_other_and_not_in_a_stack() -> None:
    known = pierced(WALL, 0.8)
    cameras = row(15)
    patches = close_holes(gallery(WALL, known, cameras))
    soup = trimesh.Trimesh(patches.vertices, patches.faces, process=False)
    layers = []
    for view in cameras[::4]:
        rays = view.rays(torch.float64)[~look(known, view).covered].numpy()
        _, ray = soup.ray.intersects_id(np.tile(view.centre, (len(rays), 1)), rays, multiple_hits=True)
        layers.append(np.bincount(ray, minlength=len(rays)))
    count = np.concatenate(layers)
    assert count.mean() < 1.3
    assert (count <= 2).mean() > 0.98


def test_what_the_photographs_contradict_is_moved() -> None:
    """Behind the hole lies something far away, unknown to the mesh: at the wall's depth views disagree."""
    known = pierced(WALL, 0.6)
    right = close_holes(gallery(WALL, known, row()))
    other = close_holes(gallery(merge(known, plate(9.0, 12.0)), known, row()))

    def in_the_hole(patches: Mesh) -> int:
        x, y, z = patches.vertices.T
        return int(((np.abs(x) < 0.45) & (np.abs(y) < 0.45) & (z < 1.2 * DEPTH)).sum())

    assert in_the_hole(other) < 0.5 * in_the_hole(right)


def test_no_patch_turns_its_back_to_a_camera_close_by() -> None:
    """The filled depth of the row reaches beyond a camera that looks away, so nobody contradicts it."""
    known = pierced(WALL, 0.6)
    beyond = DEPTH + 0.5
    away = Camera(camera(0).K, np.eye(3), -np.array([0.0, 0.0, beyond]), 96, 72)
    recess = merge(known, plate(beyond - 0.4, 3.0))  # stands before the camera that looks away
    assert in_front_of(away, close_holes(gallery(recess, known, row()))) > 0
    assert in_front_of(away, close_holes(gallery(recess, known, [*row(), away]))) == 0


def in_front_of(view: Camera, patches: Mesh) -> int:
    """Vertices between the row and a camera behind the wall, within one unit of that one."""
    distance = np.linalg.norm(patches.vertices - view.centre, axis=1)
    return int(((patches.vertices[:, 2] < view.centre[2]) & (distance < 1.0)).sum())


def test_patches_stand_where_the_photographs_agree() -> None:
    """The wall recedes within the hole, by more than what its rim tells."""
    known = pierced(WALL, 0.8)
    recess = plate(1.4 * DEPTH, 3.0)
    patches = close_holes(gallery(merge(known, recess), known, row()))
    x, y, z = patches.vertices.T
    middle = (np.abs(x) < 0.5) & (np.abs(y) < 0.5)
    assert middle.sum() > 10
    assert np.median(z[middle]) == pytest.approx(1.4 * DEPTH, rel=0.1)


def test_views_without_any_surface_are_no_obstacle() -> None:
    known = pierced(WALL, 0.6)
    away = Camera(camera(0).K, np.diag([1.0, -1.0, -1.0]), np.zeros(3), 96, 72)
    patches = close_holes(gallery(WALL, known, [*row(), away]))
    assert np.abs(patches.vertices[:, 2] / DEPTH - 1).max() < 0.02
    assert len(close_holes(gallery(WALL, known, [away, away])).faces) == 0


def test_nothing_is_added_to_what_is_closed() -> None:
    assert len(close_holes(gallery(WALL, WALL, row())).vertices) == 0


def test_masked_pixels_are_no_holes() -> None:
    known = pierced(WALL, 0.6)
    hung = gallery(WALL, known, row())
    masked = Gallery(hung.cameras, hung.images, hung.inside & hung.depth.isfinite(), hung.depth)
    assert len(close_holes(masked).vertices) == 0


def test_left_out_views_choose_closed_holes_where_these_are_right() -> None:
    known = pierced(WALL, 0.8)
    chosen, why = best_background(gallery(WALL, known, row()))
    assert chosen == "closed"
    assert "5 training views left out" in why


def test_the_walls_of_a_room_are_closed_from_inside() -> None:
    """Cameras that look outwards from a ring; two of the walls have a hole."""
    box = trimesh.creation.box(extents=[8.0, 5.0, 8.0]).subdivide_to_size(0.4)
    room = Mesh(
        np.asarray(box.vertices, np.float32),
        np.asarray(box.faces, np.int32),
        np.zeros((len(box.vertices), 3), np.uint8),
    )
    middle = room.vertices[room.faces].mean(1)
    known = drop_unused(room, ~((np.abs(middle[:, 2]) > 3.99) & (np.abs(middle[:, :2]).max(1) < 0.9)))
    views = []
    for angle in np.arange(16) * 2 * np.pi / 16:
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, 0, -s], [0, 1.0, 0], [s, 0, c]])
        views.append(Camera(camera(0).K, rotation, -rotation @ np.array([0.8 * s, 0, 0.8 * c]), 96, 72))
    hung = gallery(room, known, views)
    assert best_background(hung)[0] == "closed"
    patches = close_holes(hung)
    assert np.abs(np.abs(patches.vertices[:, 2]) / 4 - 1).max() < 0.1


def test_left_out_views_refuse_patches_that_are_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """A patch far in front of the wall shows every view the wrong piece of the others."""
    known = pierced(WALL, 0.8)
    hung = gallery(WALL, known, row())
    monkeypatch.setattr(background, "close_holes", lambda gallery: plate(0.6 * DEPTH, 0.6))
    chosen, why = best_background(hung)
    assert chosen != "closed"
    assert "closed" in why, "the figure is told all the same"


def test_nothing_is_closed_where_too_few_views_judge() -> None:
    known = pierced(WALL, 0.8)
    chosen, why = best_background(gallery(WALL, known, row(2)))
    assert chosen == "shell"
    assert "too few" in why


def test_every_geometry_is_judged_on_the_same_pixels() -> None:
    """Perfect where there is mesh, and a hole that nobody fills: the error of the hole is in the figure."""
    known = pierced(WALL, 0.8)
    psnr = score(gallery(WALL, known, row()), [2, 5], [empty_mesh(), WALL])
    assert psnr.shape == (2, 2)
    none, truth = psnr.T
    assert (truth > none + 3).all()
    assert (truth > 28).all()


def test_where_no_photograph_shows_the_background_its_colours_count() -> None:
    """The last view sees a part of the wall that the others do not: painted right, it is predicted better."""
    known = pierced(WALL, 2.0, (4.0, 0.0))
    views = [*row(3), camera(4.2)]
    right = replace(WALL, colours=texture(WALL.vertices.astype(np.float64)))
    wrong = replace(WALL, colours=255 - right.colours)
    painted = score(gallery(WALL, known, views), [3], [right, wrong])[0]
    assert painted[0] > painted[1] + 2


def test_shells_are_painted_as_if_there_were_no_patches() -> None:
    """Cameras see patches where they saw the shell; what shows where patches end has colours all the same."""
    hung = gallery(WALL, pierced(WALL, 0.8), row())
    closed = make_background("closed", hung)
    hit = [np.unique(look(closed.shell, view).face[hung.open(i)].numpy()) for i, view in enumerate(row())]
    seen = closed.shell.colours[np.unique(closed.shell.faces[np.concatenate(hit)])].astype(float)
    assert len(closed.patches.faces)
    assert seen.std(0).min() > 15, "waves, not the mean"


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 9, 40])
def test_judges_are_the_views_that_see_holes_and_few_are_left_out_at_a_time(n: int) -> None:
    hung = gallery(WALL, WALL, row(max(n, 1))).part(range(n))
    depth = hung.depth.clone()
    depth[: -(-n // 2), 20:40] = torch.inf
    turns = left_out(replace(hung, depth=depth))
    judged = sorted(i for turn in turns for i in turn)
    assert len(judged) == (0 if n < 3 else min(12, -(-n // 2)))
    assert len(judged) == len(set(judged))
    assert all(i < -(-n // 2) for i in judged)
    assert all(len(turn) <= max(1, n // 10) for turn in turns)
