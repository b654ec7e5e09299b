"""Where artificial cameras stand, over a generated ring and a generated row of cameras around a sphere."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from nmbg.cameras import Camera, foreground_sphere, up_axis
from nmbg.errors import NmbgError
from nmbg.mesh import Mesh
from nmbg.scene import Scene, View
from nmbg.sight import look
from nmbg.training.artificial import SHELL, ArtificialCameras
from nmbg.training.camera_picture import camera_picture

UP = np.array([0.0, 0.0, 1.0])
K = np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]])
LIKE = Camera(K, np.eye(3), np.zeros(3), 64, 48)


def scene(places: list[list[float]], mesh: trimesh.Trimesh, target: list[float]) -> Scene:
    cameras = [LIKE.looking_at(np.array(target), np.array(place), UP) for place in places]
    views = tuple(View(f"{i}.png", camera, "train", "", None) for i, camera in enumerate(cameras))
    sphere = foreground_sphere(cameras)
    grey = np.full((len(mesh.vertices), 3), 128, np.uint8)
    geometry = Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), grey)
    return Scene(
        Path("nowhere"), geometry, 0, 0, views, sphere.centre, sphere.radius, up_axis(cameras), 1, {}, ""
    )


@pytest.fixture
def ring() -> Scene:
    """Twelve cameras at radius 4, a little above an object of radius 1, in a room of radius 12."""
    angles = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    places = [[4 * math.cos(a), 4 * math.sin(a), 1 + 0.4 * math.sin(5 * a)] for a in angles]
    room = trimesh.creation.icosphere(subdivisions=3, radius=12.0)
    room.invert()
    thing = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return scene(places, trimesh.util.concatenate([thing, room]), [0, 0, 0.9])


@pytest.fixture
def row() -> Scene:
    """Nine cameras in a row before a wall."""
    wall = trimesh.Trimesh([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], [[0, 2, 1], [0, 3, 2]])
    places = [[0.3 * i - 1.2, 5, 0.1 * (i % 2)] for i in range(9)]
    faces = wall.subdivide().subdivide()
    made = scene(places, faces, [0, 0, 0])
    flip = ArtificialCameras(made)._inside_out
    return made if not flip else replace(made, mesh=replace(made.mesh, faces=made.mesh.faces[:, ::-1].copy()))


def drawn(made: Scene, n: int = 60) -> list[Camera]:
    artificial, generator = ArtificialCameras(made), torch.Generator().manual_seed(0)
    return [artificial.draw(generator) for _ in range(n)]


def test_around_a_ring_they_stand_in_the_papers_shell(ring: Scene) -> None:
    artificial = ArtificialCameras(ring)
    assert artificial.ring
    training = [view.camera for view in ring.train]
    away = np.stack([camera.centre for camera in training]) - ring.centre
    elevations = np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1))
    azimuths = []
    for camera in drawn(ring):
        offset = camera.centre - ring.centre
        distance = np.linalg.norm(offset)
        assert SHELL[0] * ring.radius <= distance <= SHELL[1] * ring.radius
        elevation = math.asin(offset @ ring.up / distance)
        assert abs(elevation - elevations.mean()) <= 1.5 * elevations.std() + 0.02  # up is estimated
        azimuths.append(math.atan2(offset[1], offset[0]))
        # Upright, and the sphere's centre on the axis.
        np.testing.assert_allclose(np.cross(camera.axis, ring.centre - camera.centre), 0, atol=1e-9)
        assert camera.R[1] @ ring.up < 0
        assert abs(camera.R[0] @ ring.up) < 1e-9
        assert np.linalg.det(camera.R) == pytest.approx(1)
    assert np.histogram(azimuths, bins=4, range=(-math.pi, math.pi))[0].min() > 0


def test_none_stands_inside_the_geometry(ring: Scene) -> None:
    """A wall of the thing's own size in the shell: no camera within it, nor in the solid thing."""
    blocks = [trimesh.creation.box([1.5, 1.5, 3.0], trimesh.transformations.translation_matrix(p))
              for p in ([2.6, 2.6, 1], [-2.6, 2.6, 1], [-2.6, -2.6, 1], [2.6, -2.6, 1])]  # fmt: skip
    merged = trimesh.util.concatenate(
        [
            trimesh.Trimesh(ring.mesh.vertices, ring.mesh.faces, process=False),
            *(b.subdivide() for b in blocks),
        ]
    )
    grey = np.full((len(merged.vertices), 3), 128, np.uint8)
    mesh = Mesh(merged.vertices.astype(np.float32), merged.faces.astype(np.int32), grey)
    crowded = replace(ring, mesh=mesh)
    generator = torch.Generator().manual_seed(0)
    artificial = ArtificialCameras(crowded)
    tried = [artificial._in_shell(generator) for _ in range(200)]
    within = [any(block.contains([place])[0] for block in blocks) for place in tried]
    assert any(within)
    for place, inside in zip(tried, within, strict=True):
        if inside:
            assert not artificial.admits(LIKE.looking_at(ring.centre, place, ring.up))
    for camera in drawn(crowded):
        assert not any(block.contains([camera.centre])[0] for block in blocks)


def test_before_a_wall_they_stand_between_the_cameras_and_look_at_the_focus(row: Scene) -> None:
    artificial = ArtificialCameras(row)
    assert not artificial.ring
    centres = np.stack([view.camera.centre for view in row.train])
    for camera in drawn(row):
        assert np.linalg.norm(centres - camera.centre, axis=1).min() < 1.5
        np.testing.assert_allclose(np.cross(camera.axis, row.centre - camera.centre), 0, atol=1e-9)
        assert camera.centre[1] > 0


def test_behind_a_wall_is_refused(row: Scene) -> None:
    artificial = ArtificialCameras(row)
    assert artificial.admits(LIKE.looking_at(np.zeros(3), np.array([0.1, 5, 0.2]), row.up))
    assert not artificial.admits(LIKE.looking_at(np.zeros(3), np.array([0.1, -5, 0.2]), row.up))
    assert not artificial.admits(LIKE.looking_at(np.zeros(3), np.array([0.1, 0.5, 0.2]), row.up))


def test_same_seed_same_cameras(ring: Scene) -> None:
    for a, b in zip(drawn(ring, 5), drawn(ring, 5), strict=True):
        np.testing.assert_array_equal(a.R, b.R)
        np.testing.assert_array_equal(a.t, b.t)


def test_the_picture_shows_every_camera_from_two_sides(ring: Scene) -> None:
    picture = camera_picture(ring, drawn(ring, 7))
    assert picture.startswith("<svg")
    assert picture.count('fill="#d22"') == 2 * 7
    assert picture.count('fill="#555"') == 2 * 12


def test_the_far_shell_has_no_back(ring: Scene) -> None:
    """A shell that faces outwards is seen from within by every camera, and tells nothing about its place."""
    things = len(trimesh.creation.icosphere(subdivisions=2, radius=1.0).faces)
    faces = ring.mesh.faces.copy()
    faces[things:] = faces[things:, ::-1]
    outward = replace(ring, mesh=replace(ring.mesh, faces=faces))
    artificial = ArtificialCameras(outward)
    sight = look(outward.mesh, outward.train[0].camera)
    assert artificial._facts(sight)[1] > 0.5
    artificial.scene = replace(outward, shell_faces=len(faces) - things)
    assert artificial._facts(sight)[1] == 0


def test_cameras_at_one_place_have_no_artificial_views_around_them(ring: Scene) -> None:
    alone = replace(ring, views=ring.views[:1], radius=0.0)
    with pytest.raises(NmbgError, match="stand at one place; give --artificial-views 0"):
        ArtificialCameras(alone)
