from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh

from nmbg.capacity.vertices import NEIGHBOURS, between, drop_unseen
from nmbg.mesh import Mesh, merge
from nmbg.scene import Scene
from nmbg.sight import look


def ball(centre: tuple[float, float, float]) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    vertices = (sphere.vertices + centre).astype(np.float32)
    return Mesh(vertices, sphere.faces.astype(np.int32), np.zeros(vertices.shape, np.uint8))


def test_what_is_hidden_goes_and_training_views_see_the_same(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    hidden = ball((0.0, 0.0, 0.8))  # inside the textured ball
    first = replace(scene, mesh=merge(hidden, scene.mesh))
    less = drop_unseen(first)
    # The hidden ball stands first and would have kept its places.
    assert not np.isin(hidden.vertices, less.mesh.vertices).all(1).any()
    assert len(less.mesh.vertices) <= len(first.mesh.vertices) - len(hidden.vertices)
    for view in scene.train:
        assert torch.equal(look(first.mesh, view.camera).depth, look(less.mesh, view.camera).depth)


def test_the_shell_stays_whole(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    shell = ball((0.0, 0.0, 0.8))  # in sight of no camera, but called a shell
    whole = replace(
        scene,
        mesh=merge(scene.mesh, shell),
        shell_vertices=len(shell.vertices),
        shell_faces=len(shell.faces),
    )
    less = drop_unseen(whole)
    assert (less.shell_vertices, less.shell_faces) == (len(shell.vertices), len(shell.faces))
    assert np.array_equal(less.mesh.vertices[-len(shell.vertices) :], shell.vertices)
    assert less.mesh.faces[: -len(shell.faces)].max() < len(less.mesh.vertices) - len(shell.vertices)


def test_a_camera_between_two_stands_halfway_and_looks_as_both_do(scene_folder: Path) -> None:
    cameras = [view.camera for view in Scene.load(scene_folder).train]
    halfway = between(cameras)
    assert len(halfway) == NEIGHBOURS * len(cameras)
    for i, middle in enumerate(halfway):
        camera = cameras[i // NEIGHBOURS]
        order = sorted(cameras, key=lambda c: float(np.linalg.norm(c.centre - camera.centre)))
        other = order[1 + i % NEIGHBOURS]
        assert np.allclose(middle.centre, (camera.centre + other.centre) / 2)
        assert np.isclose(middle.axis @ camera.axis, middle.axis @ other.axis)
    assert between(cameras[:1]) == []
