from __future__ import annotations

import numpy as np
import pytest
import torch

from nmbg.cameras import Camera
from nmbg.mesh import Mesh, load_mesh, merge
from nmbg.reconstruct.gallery import Gallery
from nmbg.reconstruct.shell import MOST_VERTICES, far_shell
from nmbg.scene import Scene
from nmbg.sight import look


@pytest.fixture(scope="module")
def scene(scene_folder) -> Scene:
    return Scene.load(scene_folder)


def parts(scene: Scene) -> tuple[Mesh, list[Camera], list[Camera]]:
    """The mesh without shell, the training cameras and the held-out ones."""
    mesh = scene.mesh
    n, m = len(mesh.vertices) - scene.shell_vertices, len(mesh.faces) - scene.shell_faces
    bare = Mesh(mesh.vertices[:n], mesh.faces[:m], mesh.colours[:n])
    return bare, [v.camera for v in scene.train], [v.camera for v in scene.test]


def hung(mesh: Mesh, cameras: list[Camera]) -> Gallery:
    """Cameras with their depth of a mesh, and black photographs."""
    sizes = [(camera.height, camera.width) for camera in cameras]
    return Gallery.hang(
        [look(mesh, camera) for camera in cameras],
        [np.zeros((*size, 3), np.uint8) for size in sizes],
        [np.ones(size, bool) for size in sizes],
    )


def face(mesh: Mesh, camera: Camera) -> np.ndarray:
    return look(mesh, camera).face.numpy()


def test_the_shell_fills_every_view_and_hides_nothing(scene: Scene) -> None:
    mesh, train, test = parts(scene)
    shell = far_shell(hung(mesh, train))
    assert len(shell.vertices) <= MOST_VERTICES
    for camera in train + test:
        alone, together = face(mesh, camera), face(merge(mesh, shell), camera)
        assert (together >= 0).all()
        assert np.array_equal(together[alone >= 0], alone[alone >= 0])
        assert (alone < 0).any()


def test_the_shell_closes_a_hole_where_the_surface_was(scene: Scene) -> None:
    """A hole in the ground: what stands behind it lies near the plane, not at the far end of the scene."""
    mesh, train, _ = parts(scene)
    centres = mesh.vertices[mesh.faces].mean(1)
    hole = (np.abs(centres[:, 2]) < 1e-3) & (np.linalg.norm(centres[:, :2] - [1.5, 0], axis=1) < 0.45)
    assert hole.any()
    pierced = Mesh(mesh.vertices, mesh.faces[~hole], mesh.colours)
    shell = far_shell(hung(pierced, train))
    errors = []
    for camera in train:
        truth = look(mesh, camera)
        through = look(merge(pierced, shell), camera)
        missing = truth.covered & ~look(pierced, camera).covered
        errors.append((through.depth[missing] / truth.depth[missing]).log())
    ratio = torch.cat(errors)
    assert len(ratio) > 20
    assert ratio.median().exp() < 1.6
    assert ratio.min().exp() > 0.98, "it stands behind"


def test_a_closed_room_still_gets_a_shell_that_hides_nothing(shared_workspace) -> None:
    """Asked for although nothing is uncovered: a box seen from inside."""
    ball, _ = load_mesh(shared_workspace / "meshed-delaunay.ply")
    corners = np.array([[x, y, z] for x in (-9, 9) for y in (-9, 9) for z in (-9, 9)], np.float32)
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    faces = np.array([(a, *rest) for a, b, c, d in sides for rest in ((b, c), (c, d))], np.int32)
    box = merge(ball, Mesh(corners, faces, np.zeros((8, 3), np.uint8)))
    K = np.array([[30.0, 0, 32], [0, 30.0, 24], [0, 0, 1]])
    cameras = [Camera(K, np.eye(3), np.array([x, 0.1, 4.0]), 64, 48) for x in (-0.5, 0.0, 0.5)]
    shell = far_shell(hung(box, cameras))
    for camera in cameras:
        assert np.array_equal(face(merge(box, shell), camera), face(box, camera))
