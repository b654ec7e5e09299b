from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nmbg.cameras import Camera, foreground_sphere, nearest_point_to_axes, up_axis
from nmbg.importers import read_capture


def camera_at(centre: list[float], target: list[float], size: tuple[int, int] = (64, 48)) -> Camera:
    """A camera that looks from `centre` to `target`, with the world's z up."""
    c = np.array(centre, dtype=float)
    forward = np.array(target, dtype=float) - c
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[60.0, 0, 32.7], [0, 61.0, 23.6], [0, 0, 1]])
    return Camera(K, R, -R @ c, *size)


def pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    h = camera.project(torch.from_numpy(points)).numpy()
    return h[:, :2] / h[:, 2:]


def mean_reprojection_error(model: pycolmap.Reconstruction, photos: dict[str, Camera], lenses: dict) -> float:
    """Distance between projections and observations: the mean over points of the mean over their images.

    Cameras are pinholes; a photograph's lens, where it has one, takes projections back to the model's image.
    """
    errors: dict[int, list[float]] = {}
    for image in model.images.values():
        camera, lens = photos[image.name], lenses[image.name]
        observed = [p for p in image.points2D if p.has_point3D()]
        points = np.stack([model.points3D[p.point3D_id].xyz for p in observed])
        uv = pixels(camera, points)
        if lens is not None:
            normalised = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) @ np.linalg.inv(camera.K).T
            uv = lens.img_from_cam(normalised)
        else:
            # The same image at another size: observations are in pixels of the model's camera.
            uv = uv * [image.camera.width / camera.width, image.camera.height / camera.height]
        distances = np.linalg.norm(uv - np.stack([p.xy for p in observed]), axis=1)
        for p, distance in zip(observed, distances.tolist(), strict=True):
            errors.setdefault(p.point3D_id, []).append(distance)
    return float(np.mean([np.mean(list_) for list_ in errors.values()]))


@pytest.mark.parametrize(
    "model",
    [
        "SIMPLE_PINHOLE",
        "PINHOLE",
        "SIMPLE_RADIAL",
        "RADIAL",
        "OPENCV",
        "FULL_OPENCV",
        "FOV",
        "OPENCV_FISHEYE",
    ],
)
def test_points_project_onto_their_observations_as_colmap_says(
    model: str, make_workspace: Callable[..., Path], tmp_path: Path
) -> None:
    workspace = make_workspace(tmp_path / "capture", model)
    reconstruction = pycolmap.Reconstruction(workspace / "sparse" / "0")
    photos = read_capture(workspace).photos
    lenses = {photo.name: photo.lens for photo in photos}
    error = mean_reprojection_error(reconstruction, {p.name: p.camera for p in photos}, lenses)
    assert error == pytest.approx(reconstruction.compute_mean_reprojection_error(), abs=1e-5)
    assert 0.3 < error < 1


def test_resized_cameras_project_onto_the_same_observations(shared_workspace: Path) -> None:
    reconstruction = pycolmap.Reconstruction(shared_workspace / "sparse" / "0")
    cameras = {p.name: p.camera.resized(23, 31) for p in read_capture(shared_workspace).photos}
    error = mean_reprojection_error(reconstruction, cameras, dict.fromkeys(cameras))
    assert error == pytest.approx(reconstruction.compute_mean_reprojection_error(), abs=1e-9)


def test_a_transposed_rotation_does_not_project_onto_the_observations(shared_workspace: Path) -> None:
    reconstruction = pycolmap.Reconstruction(shared_workspace / "sparse" / "0")
    photos = read_capture(shared_workspace).photos
    swapped = {
        p.name: Camera(p.camera.K, p.camera.R.T, p.camera.t, p.camera.width, p.camera.height) for p in photos
    }
    assert mean_reprojection_error(reconstruction, swapped, dict.fromkeys(swapped)) > 5


@pytest.mark.captures
@pytest.mark.parametrize("capture", ["fox/dense", "kitchen"])
def test_real_captures_project_as_colmap_says(capture: str, captures: Path) -> None:
    photos = read_capture(captures / capture).photos
    folder = captures / capture / "sparse"
    reconstruction = pycolmap.Reconstruction(folder if (folder / "cameras.bin").exists() else folder / "0")
    reconstruction.update_point_3d_errors()  # a dense workspace keeps those of the images before undistortion
    lenses = {p.name: p.lens for p in photos}
    error = mean_reprojection_error(reconstruction, {p.name: p.camera for p in photos}, lenses)
    assert error == pytest.approx(reconstruction.compute_mean_reprojection_error(), abs=1e-4)


sizes = st.integers(1, 3000)


@given(width=sizes, height=sizes, k=st.integers(0, 6))
def test_levels_halve_pixels_exactly(width: int, height: int, k: int) -> None:
    camera = camera_at([3, 1, 2], [0, 0, 0], (width, height))
    level = camera.level(k)
    assert np.array_equal(level.K, np.diag([0.5**k, 0.5**k, 1]) @ camera.K)
    assert (level.width, level.height) == (-(-width // 2**k), -(-height // 2**k))


@given(width=sizes, height=sizes, x0=st.floats(-50, 50), y0=st.floats(-50, 50))
def test_resizing_and_cropping_move_pixels_as_they_say(width: int, height: int, x0: float, y0: float) -> None:
    camera = camera_at([3, 1, 2], [0, 0, 0])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    before = pixels(camera, points)
    resized = camera.resized(width, height)
    assert np.allclose(pixels(resized, points), before * [width / 64, height / 48], rtol=1e-12)
    cropped = camera.cropped(x0, y0, width, height)
    assert np.allclose(pixels(cropped, points), before - [x0, y0], rtol=0, atol=1e-9)
    assert (cropped.width, cropped.height) == (width, height)


def test_padding_moves_nothing() -> None:
    camera = camera_at([3, 1, 2], [0, 0, 0], (65, 48))
    padded = camera.padded(16)
    assert (padded.width, padded.height) == (80, 48)
    assert np.array_equal(padded.K, camera.K)


def test_rays_pass_through_pixel_centres() -> None:
    camera = camera_at([3, 1, 2], [0, 0, 0])
    rays = camera.rays(torch.float64).numpy()
    assert rays.shape == (48, 64, 3)
    uv = pixels(camera, camera.centre + 2.5 * rays.reshape(-1, 3)).reshape(48, 64, 2)
    v, u = np.mgrid[:48, :64]
    assert np.allclose(uv, np.stack([u + 0.5, v + 0.5], axis=-1), atol=1e-9)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1)


def test_projection_far_from_the_origin_keeps_float32_points_exact() -> None:
    near = camera_at([3, 1, 2], [0, 0, 0])
    offset = np.array([4096.0, -8192.0, 1024.0])
    far = Camera(near.K, near.R, near.t - near.R @ offset, near.width, near.height)
    points = torch.tensor([[0.25, -0.5, 0.125]], dtype=torch.float32)
    moved = points + torch.from_numpy(offset).float()
    assert torch.allclose(far.project(moved), near.project(points), atol=1e-3)


def ring(n: int, height: float, arc: float = 2 * np.pi, radius: float = 4.0) -> list[Camera]:
    angles = np.linspace(0, arc, n, endpoint=arc < 2 * np.pi)
    return [camera_at([radius * np.cos(a), radius * np.sin(a), height], [0, 0, 0]) for a in angles]


def test_axes_meet_where_the_cameras_look() -> None:
    assert np.allclose(nearest_point_to_axes(ring(9, 2.0)), 0, atol=1e-9)


def test_parallel_axes_keep_the_mean_centre() -> None:
    cameras = [camera_at([x, 5, 1], [x, 0, 1]) for x in (10.0, 11.0, 12.0)]
    assert np.allclose(nearest_point_to_axes(cameras), [11, 5, 1])


def test_up_is_against_the_cameras_y_axes() -> None:
    assert np.allclose(up_axis(ring(8, 0.0)), [0, 0, 1], atol=1e-9)


def test_sphere_of_a_ring_is_the_mean_centre_and_a_tenth_more_than_the_largest_distance() -> None:
    sphere = foreground_sphere(ring(9, 2.0))
    assert sphere.ring
    assert np.allclose(sphere.centre, [0, 0, 2], atol=1e-9)
    assert sphere.radius == pytest.approx(1.1 * 4)


def test_an_octant_is_no_ring_and_its_sphere_stands_where_it_looks() -> None:
    sphere = foreground_sphere(ring(9, 3.0, arc=np.pi / 2))
    assert not sphere.ring
    assert np.allclose(sphere.centre, 0, atol=1e-9)
    assert sphere.radius == pytest.approx(1.1 * 5)
