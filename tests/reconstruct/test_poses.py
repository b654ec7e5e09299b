from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from nmbg.cameras import Camera
from nmbg.demo.capture import CaptureConfig, make_capture
from nmbg.errors import NmbgError
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.reconstruct.poses import _step, refine_poses, without_common_motion
from nmbg.scene import Scene
from nmbg.training.run_views import load_cameras, load_views, save_views

K = np.array([[80.0, 0, 40], [0, 80.0, 30], [0, 0, 1]])


def moved(camera: Camera, twist: np.ndarray) -> Camera:
    """A camera whose points move by (ω, v) in its frame."""
    turn = Rotation.from_rotvec(twist[:3]).as_matrix()
    return replace(camera, R=turn @ camera.R, t=turn @ camera.t + twist[3:])


def painted(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth texture on the surface z = 4 + 0.3 sin(x + y), and its depth, by fixed-point iteration."""
    rays = camera.rays(torch.float64).numpy()
    along = rays / (rays @ camera.R[2])[..., None]  # unit view-space z
    z = np.full(rays.shape[:2], 4.0)
    for _ in range(60):
        points = camera.centre + z[..., None] * along
        z += 0.7 * (4 + 0.3 * np.sin(points[..., 0] + points[..., 1]) - points[..., 2])
    x, y, _ = (camera.centre + z[..., None] * along).transpose(2, 0, 1)
    waves = [np.sin(2.1 * x + 0.4), np.sin(1.7 * y - 0.3 * x), np.cos(1.3 * x + 1.9 * y)]
    return torch.from_numpy(0.5 + 0.3 * np.stack(waves)).float(), torch.from_numpy(z).float()


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_step_goes_back_to_where_the_photograph_was_taken(axis: int, sign: int) -> None:
    """One parameter is disturbed; steps without any doubt bring the true pose back."""
    true = Camera(K, np.eye(3), np.zeros(3), 80, 60)
    photograph, _ = painted(true)
    twist = np.zeros(6)
    twist[axis] = sign * (0.01 if axis < 3 else 0.04)
    camera = moved(true, twist)
    for _ in range(8):
        colour, depth = painted(camera)
        counted = torch.ones_like(depth, dtype=torch.bool)
        camera = moved(camera, _step(camera, photograph, colour, depth, counted, np.zeros(6), np.zeros(6)))
    angle = Rotation.from_matrix(camera.R @ true.R.T).magnitude()
    assert angle < 0.1 * 0.01
    assert np.linalg.norm(camera.centre) < 0.1 * 0.04


def test_doubt_keeps_a_camera_where_it_was_given() -> None:
    true = Camera(K, np.eye(3), np.zeros(3), 80, 60)
    photograph, _ = painted(true)
    camera = moved(true, np.array([0.01, 0, 0, 0, 0, 0]))
    colour, depth = painted(camera)
    counted = torch.ones_like(depth, dtype=torch.bool)
    free, held = (
        np.linalg.norm(_step(camera, photograph, colour, depth, counted, np.full(6, d), np.zeros(6)))
        for d in (0.0, 1e6)
    )
    assert held < 1e-3 * free
    back = _step(camera, photograph, colour, depth, counted, np.full(6, 1e9), np.full(6, 0.3))
    np.testing.assert_allclose(back, -0.3, rtol=1e-3)


def test_too_few_pixels_move_nothing() -> None:
    camera = Camera(K, np.eye(3), np.zeros(3), 80, 60)
    image, depth = painted(camera)
    counted = torch.zeros_like(depth, dtype=torch.bool)
    counted[:10, :10] = True
    step = _step(camera, image + 0.1, image, depth, counted, np.zeros(6), np.zeros(6))
    np.testing.assert_array_equal(step, 0)


def test_what_all_cameras_do_together_is_undone() -> None:
    rng = np.random.default_rng(0)
    cameras = [
        Camera(K, Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3), 80, 60)
        for _ in range(7)
    ]
    turn, shift = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix(), np.array([0.3, 0.1, -0.2])
    together = [replace(c, R=c.R @ turn.T, t=c.t - c.R @ turn.T @ shift) for c in cameras]
    for before, after in zip(cameras, without_common_motion(cameras, together), strict=True):
        np.testing.assert_allclose(after.R, before.R, atol=1e-9)
        np.testing.assert_allclose(after.centre, before.centre, atol=1e-9)


def test_disturbed_poses_come_back_on_a_capture(tmp_path: Path) -> None:
    make_capture(tmp_path / "capture", CaptureConfig(views=20, width=160, height=120, samples=1, points=300))
    scene = preprocess(tmp_path / "capture", tmp_path / "scene", PreprocessOptions())
    rng = np.random.default_rng(1)

    def disturbed(camera: Camera) -> Camera:
        twist = rng.normal(size=6) * np.repeat([np.radians(0.5), 0.01 * scene.radius], 3) / np.sqrt(3)
        return moved(camera, twist)

    views = tuple(replace(v, camera=disturbed(v.camera)) if v.split == "train" else v for v in scene.views)
    bad = replace(scene, views=views)
    good = refine_poses(bad)

    def errors(found: Scene) -> np.ndarray:
        pairs = zip(scene.train, found.train, strict=True)
        return np.array([_shift(a.camera, b.camera, scene.centre) for a, b in pairs])

    assert np.median(errors(good)) < 0.7 * np.median(errors(bad))
    # Sound poses are better than what alignment finds.
    assert refine_poses(scene, blurs=(2, 1, 0)) is scene
    for before, after in zip(scene.test, good.test, strict=True):
        np.testing.assert_array_equal(before.camera.projection, after.camera.projection)


def _shift(a: Camera, b: Camera, point: np.ndarray) -> float:
    """How far a point at the middle of the scene moves in the image, pixels."""
    u, v = (p[:2] / p[2] for p in (camera.projection @ np.append(point, 1.0) for camera in (a, b)))
    return float(np.linalg.norm(u - v))


def test_poses_of_a_run_are_kept(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    views = tuple(replace(v, camera=moved(v.camera, np.full(6, 0.01))) for v in scene.views)
    save_views(tmp_path, replace(scene, views=views), {})
    found = load_views(tmp_path, scene)
    for view, old, new in zip(found.views, scene.views, views, strict=True):
        wanted = new if view.split == "train" else old
        np.testing.assert_allclose(view.camera.projection, wanted.camera.projection, atol=1e-12)
    trained = [view.camera for view in found.train]
    for read, camera in zip(load_cameras(tmp_path), trained, strict=True):
        np.testing.assert_array_equal(read.projection, camera.projection)
        assert (read.width, read.height) == (camera.width, camera.height)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"left_out": {}, "cameras": {}}'])
def test_damaged_views_are_named(scene_folder: Path, tmp_path: Path, content: str) -> None:
    (tmp_path / "views.json").write_text(content)
    with pytest.raises(NmbgError, match=r"views\.json"):
        load_views(tmp_path, Scene.load(scene_folder))
