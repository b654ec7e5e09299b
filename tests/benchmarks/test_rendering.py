"""Unlikely cameras are what they are said to be; a perfect renderer loses nothing by them."""

import numpy as np
import pytest
import torch
from stress.curves import breaking_point, broken
from stress.rendering import RENDERINGS, Place, random_camera
from warp import psnr, warped

from nmbg.cameras import Camera
from nmbg.scene import Scene


@pytest.fixture
def place() -> Place:
    camera = Camera(np.array([[50.0, 0, 31], [0, 52.0, 25], [0, 0, 1]]), np.eye(3), np.zeros(3), 64, 48)
    return Place(camera, depth=4.0, radius=10.0)


def plane(camera: Camera, z: float = 4.0) -> tuple[torch.Tensor, torch.Tensor]:
    """What a camera that looks along z sees of a smooth pattern on the plane at z: picture and depth."""
    rays = camera.rays(torch.float64)
    along = torch.from_numpy(camera.R[2])
    step = (z - camera.centre[2]) / rays[..., 2]
    points = torch.from_numpy(camera.centre) + step[..., None] * rays
    image = torch.stack(
        [0.5 + 0.3 * torch.sin((points[..., 0] * k + points[..., 1]) / 20) for k in (1, 2, 3)]
    )
    return image.float(), (step * (rays @ along)).float()


@pytest.mark.parametrize("rendering", RENDERINGS, ids=lambda rendering: rendering.name)
def test_the_first_severity_is_the_photographs_camera(place, rendering):
    camera, scale = rendering.change(place, rendering.severities[0])
    np.testing.assert_allclose(camera.projection, place.camera.projection, atol=1e-9)
    assert (camera.width, camera.height, scale) == (place.camera.width, place.camera.height, 1)


@pytest.mark.parametrize("rendering", RENDERINGS, ids=lambda rendering: rendering.name)
def test_what_both_see_is_the_same(place, rendering):
    truth, depth = plane(place.camera)
    for severity in rendering.severities:
        camera, scale = rendering.change(place, severity)
        if camera.centre[2] > 3.9:
            continue
        of = place.camera
        if scale < 1:
            of = of.resized(round(scale * of.width), round(scale * of.height))
            truth, depth = plane(of)
        shown, seen = warped(*_with_camera(camera), of, depth)
        assert seen.any()
        assert psnr(shown, truth, seen) > 35


def _with_camera(camera: Camera) -> tuple[torch.Tensor, Camera, torch.Tensor]:
    image, depth = plane(camera)
    return image, camera, depth


def test_hidden_surface_does_not_count(place):
    image, depth = plane(place.camera)
    _, seen = warped(image, place.camera, depth, place.camera, 1.5 * depth)
    assert not seen.any()
    assert psnr(image, image, seen) is None


def test_random_cameras_repeat_and_are_sound(scene_folder):
    scene = Scene.load(scene_folder)
    cameras = [[random_camera(scene, np.random.default_rng(i)) for i in range(20)] for _ in range(2)]
    for a, b in zip(*cameras, strict=True):
        assert np.array_equal(a.projection, b.projection)
        np.testing.assert_allclose(a.R @ a.R.T, np.eye(3), atol=1e-12)
        assert min(a.width, a.height) >= 1
        assert np.isfinite(a.projection).all()


def test_breaking_points_lie_between_what_was_measured():
    def curve(*losses: float | None) -> list[dict]:
        return [{"severity": i, "psnr": 30.0, "loss": loss} for i, loss in enumerate(losses)]

    assert breaking_point(curve(0, 1, 5)) == pytest.approx(1.5)
    assert breaking_point(curve(0, None, 6)) == pytest.approx(1)
    assert breaking_point(curve(0, 1, 2.9)) is None
    assert broken(curve(0, 1, 5, 9))["severity"] == 2
    assert broken(curve(0, 1, 2))["severity"] == 2
