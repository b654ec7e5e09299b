"""The demo's capture: cameras, photographs, points and mesh agree, and the mesh is as bad as stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
import trimesh

from nmbg.demo.appearance import DOME_RADIUS, Appearance, encode
from nmbg.demo.capture import (
    CaptureConfig,
    Surface,
    joined,
    looking_at,
    make_capture,
    noisy_mesh,
    two_rings,
)
from nmbg.demo.shapes import TERRACE_RADIUS, build_parts, vertex_normals
from nmbg.images import read_image
from nmbg.mesh import load_mesh

SMALL = CaptureConfig(
    views=6, width=48, height=36, samples=2, true_edge=0.06, mesh_edge=0.1, points=300, seed=3
)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "capture"
    make_capture(folder, SMALL)
    return folder


@pytest.fixture(scope="module")
def model(capture: Path) -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(str(capture / "sparse" / "0"))


@pytest.fixture(scope="module")
def surface() -> Surface:
    return Surface(build_parts(SMALL.true_edge), Appearance(SMALL.seed))


@pytest.mark.parametrize("edge", [0.05, 0.13])
def test_objects_are_closed_and_face_outwards(edge: float) -> None:
    terrace, *objects = build_parts(edge)
    assert not trimesh.Trimesh(terrace.vertices, terrace.faces, process=False).is_watertight
    for part in objects:
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_watertight, part.name
        assert mesh.is_winding_consistent, part.name
        assert mesh.volume > 0, part.name
        assert mesh.edges_unique_length.mean() == pytest.approx(edge, rel=0.35), part.name
        assert mesh.vertices[:, 2].min() > -0.02, part.name


def test_the_terrace_is_a_disc_that_faces_up() -> None:
    terrace = build_parts(0.1)[0]
    assert np.linalg.norm(terrace.vertices, axis=1).max() == pytest.approx(TERRACE_RADIUS)
    np.testing.assert_allclose(
        vertex_normals(terrace.vertices, terrace.faces), [[0, 0, 1]] * len(terrace.vertices)
    )


def test_looking_at_puts_the_target_in_the_middle_and_up_above() -> None:
    camera = looking_at(np.array([2.0, -1.0, 1.5]), np.array([0.1, 0.2, 0.3]), 50, 40, 30)
    np.testing.assert_allclose(camera.centre, [2, -1, 1.5])
    np.testing.assert_allclose(camera.R @ camera.R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.R) == pytest.approx(1)
    h = camera.project(torch.tensor([[0.1, 0.2, 0.3], [0.1, 0.2, 0.4]], dtype=torch.float64))
    pixel = (h[:, :2] / h[:, 2:]).numpy()
    np.testing.assert_allclose(pixel[0], [20, 15], atol=1e-9)
    assert pixel[1, 1] < 15
    assert pixel[1, 0] == pytest.approx(20)


def test_half_of_the_cameras_stand_on_each_ring() -> None:
    heights = np.array([camera.centre[2] for camera in two_rings(replace(SMALL, views=21))])
    assert (heights < 1.5).sum() == 11
    assert np.all(
        np.diff(np.sign(heights - 1.5)) >= 0
    )  # one ring after the other, so that every n-th view is of both


def test_the_workspace_is_complete(capture: Path, model: pycolmap.Reconstruction) -> None:
    assert model.num_reg_images() == SMALL.views
    assert {camera.model_name for camera in model.cameras.values()} == {"PINHOLE"}
    for image in model.images.values():
        assert read_image(capture / "images" / image.name).shape == (SMALL.height, SMALL.width, 3)
    assert not list(capture.parent.glob(".*"))


def test_points_project_onto_their_observations(model: pycolmap.Reconstruction) -> None:
    cameras = two_rings(SMALL)
    distances = []
    for point in model.points3D.values():
        assert point.track.length() >= 2
        for element in point.track.elements:
            u, v, z = cameras[element.image_id - 1].projection @ np.append(point.xyz, 1)
            assert z > 0
            seen = model.image(element.image_id).points2D[element.point2D_idx].xy
            distances.append(np.linalg.norm([u / z, v / z] - seen))
    assert len(distances) > 120
    # Two coordinates with a noise of 0.25 px each: a Rayleigh distribution.
    assert np.mean(distances) == pytest.approx(0.25 * np.sqrt(np.pi / 2), rel=0.15)
    # COLMAP's is the mean over the points, not over the observations.
    assert model.compute_mean_reprojection_error() == pytest.approx(np.mean(distances), rel=0.02)


def test_depth_is_that_of_an_independent_ray_caster(surface: Surface) -> None:
    camera = two_rings(SMALL)[1]
    face, depth = surface.depth(camera)
    mesh = trimesh.Trimesh(surface.vertices.double().numpy(), surface.faces.numpy(), process=False)
    rays = camera.rays(torch.float64).reshape(-1, 3).numpy()
    hits, ray, _ = mesh.ray.intersects_location(
        np.tile(camera.centre, (len(rays), 1)), rays, multiple_hits=False
    )
    cast = np.zeros(len(rays))
    cast[ray] = (hits - camera.centre) @ camera.axis
    different = np.abs(cast.reshape(depth.shape) - depth.numpy()) > 1e-3
    assert (face >= 0).float().mean() > 0.5
    assert different.mean() < 0.005


def test_a_photograph_shows_the_part_that_stands_there(surface: Surface) -> None:
    """The ball is red and cream, and in this view the terrace is nowhere as warm in the mean."""
    camera = looking_at(np.array([3.4, 0.2, 0.9]), np.array([0.72, 0.55, 0.5]), 40, 40, 40)
    image = surface.photograph(camera, samples=2).astype(int)
    face, _ = surface.depth(camera)
    ends = np.cumsum([len(part.faces) for part in build_parts(SMALL.true_edge)])
    ball = (face.numpy() >= ends[0]) & (face.numpy() < ends[1])
    warm = image[..., 0] - image[..., 2] > 12
    assert ball.mean() > 0.1
    assert warm[ball].mean() > 0.75
    assert warm[~ball].mean() < 0.5


def test_more_samples_only_refine_a_photograph(surface: Surface) -> None:
    camera = two_rings(SMALL)[0]
    coarse, fine = (surface.photograph(camera, samples).astype(float) for samples in (3, 4))
    assert np.sqrt(((coarse - fine) ** 2).mean()) < 8
    moved = np.sqrt(((coarse - np.roll(fine, 1, axis=1)) ** 2).mean())
    assert np.sqrt(((coarse - fine) ** 2).mean()) < 0.5 * moved


def test_highlights_depend_on_the_view(surface: Surface) -> None:
    position = torch.tensor([[0.72, 0.55, 1.0]])  # the top of the ball
    up = torch.tensor([[0.0, 0.0, 1.0]])
    sun = torch.ones(1)
    seen = [
        surface.appearance.surface("sphere", position - position, position, up, torch.tensor(eye), sun)
        for eye in ([-2.0, 4.0, 4.0], [3.0, -3.0, 4.0])
    ]
    assert (seen[0] - seen[1]).abs().max() > 0.1


def test_shadows_lie_beside_objects_and_not_in_the_open(surface: Surface) -> None:
    sunlit = surface._sun
    terrace = surface.vertices[:, 2] == 0
    open_ground = terrace & (surface.vertices[:, :2].norm(dim=1) > 3)
    under_the_box = terrace & ((surface.vertices[:, :2] - torch.tensor([-0.62, 0.78])).norm(dim=1) < 0.2)
    assert sunlit[open_ground].mean() > 0.98
    assert sunlit[under_the_box].max() == 0


def test_the_landscape_has_parallax_as_a_dome_of_its_radius() -> None:
    appearance = Appearance(0)
    direction = torch.nn.functional.normalize(
        torch.randn(500, 3, generator=torch.Generator().manual_seed(0)), dim=1
    )
    origin = torch.tensor([1.0, -2.0, 0.5])
    from_the_middle = torch.nn.functional.normalize(DOME_RADIUS * direction - origin, dim=1)
    seen = appearance.landscape(torch.zeros(3), direction)
    torch.testing.assert_close(appearance.landscape(origin, from_the_middle), seen, atol=2e-3, rtol=0)
    assert seen.min() >= 0
    assert seen.std() > 0.05


def test_encode_is_srgb() -> None:
    light = torch.tensor([-1.0, 0.0, 0.002, 0.21404, 1.0, 7.0])
    torch.testing.assert_close(encode(light), torch.tensor([0, 0, 0.02584, 0.5, 1, 1]), atol=1e-4, rtol=0)


def test_the_mesh_is_off_the_surface_by_the_stated_noise(capture: Path) -> None:
    mesh, _ = load_mesh(capture / "meshed-delaunay.ply")
    true, _ = joined(build_parts(SMALL.mesh_edge))
    distance = np.linalg.norm(mesh.vertices - true, axis=1)
    # The mean of the absolute value of a normal distribution.
    assert distance.mean() == pytest.approx(SMALL.noise * SMALL.mesh_edge * np.sqrt(2 / np.pi), rel=0.05)
    along = np.abs(((mesh.vertices - true) * vertex_normals(*joined(build_parts(SMALL.mesh_edge)))).sum(1))
    np.testing.assert_allclose(along, distance, atol=1e-5)


def test_the_mesh_has_no_background_and_is_coarser() -> None:
    mesh = noisy_mesh(SMALL)
    fine, _ = joined(build_parts(SMALL.true_edge))
    assert np.linalg.norm(mesh.vertices, axis=1).max() < TERRACE_RADIUS + 0.1
    assert len(mesh.vertices) < len(fine) / 2


def test_the_seed_decides_everything(capture: Path, tmp_path: Path) -> None:
    make_capture(tmp_path / "again", SMALL)
    make_capture(tmp_path / "other", replace(SMALL, seed=4))
    files = sorted(
        path.relative_to(capture) for path in capture.rglob("*") if path.stat().st_size and path.is_file()
    )
    assert len(files) >= SMALL.views + 4
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (capture / file).read_bytes(), file
    assert (tmp_path / "other" / "images" / "000.png").read_bytes() != (
        capture / "images" / "000.png"
    ).read_bytes()
