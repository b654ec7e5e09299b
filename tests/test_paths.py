"""Camera paths: where they pass, and how evenly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nmbg.cameras import Camera
from nmbg.paths import through


def ring(n: int, turn: float = 2 * np.pi, wobble: float = 0.0, seed: int = 0) -> list[Camera]:
    """Cameras on a part of a circle, looking inwards, each then turned by up to `wobble` radians."""
    rng = np.random.default_rng(seed)
    K = np.array([[80.0, 0, 32], [0, 81.0, 24], [0, 0, 1]])
    cameras = []
    for angle in np.linspace(0, turn, n):
        place = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.0])
        camera = Camera(K, np.eye(3), np.zeros(3), 64, 48).looking_at(np.zeros(3), place, np.eye(3)[2])
        R = Rotation.from_rotvec(wobble * rng.uniform(-1, 1, 3)).as_matrix() @ camera.R
        cameras.append(Camera(K, R, -R @ place, 64, 48))
    return cameras


@given(n=st.integers(2, 7), frames=st.integers(2, 40), wobble=st.floats(0, 0.5), seed=st.integers(0, 99))
def test_a_path_begins_and_ends_at_its_cameras_and_is_made_of_rotations(n, frames, wobble, seed):
    cameras = ring(n, 1.5, wobble, seed)
    path = through(cameras, frames)
    assert len(path) == frames
    for ours, theirs in ((path[0], cameras[0]), (path[-1], cameras[-1])):
        np.testing.assert_allclose(ours.projection, theirs.projection, atol=1e-9)
    for camera in path:
        np.testing.assert_allclose(camera.R @ camera.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.R) > 0
        assert (camera.width, camera.height) == (64, 48)


def test_a_path_passes_through_every_camera_and_stays_on_a_circle_of_them() -> None:
    cameras = ring(9, np.pi)
    path = through(cameras, 8 * 10 + 1)
    for camera, passed in zip(cameras, path[::10], strict=True):
        np.testing.assert_allclose(passed.projection, camera.projection, atol=1e-6)
    for camera in path:
        np.testing.assert_allclose(np.linalg.norm(camera.centre[:2]), 3, atol=5e-3)
        np.testing.assert_allclose(camera.axis, -camera.centre / np.linalg.norm(camera.centre), atol=5e-3)


def test_the_pace_is_steady_where_cameras_stand_unevenly() -> None:
    dense, wide = ring(30, 1.0), ring(3, 1.0)
    uneven = [*dense[:15], *wide[1:]]  # 14 short steps, then a long one
    path = through(uneven, 101)
    steps = np.linalg.norm(np.diff([camera.centre for camera in path], axis=0), axis=1)
    assert steps.max() < 1.2 * steps.min()


def test_cameras_at_one_place_turn_there() -> None:
    a, b = ring(2, 0.0, wobble=0.4)
    path = through([a, b], 5)
    for camera in path:
        np.testing.assert_allclose(camera.centre, a.centre, atol=1e-9)
    half = Rotation.from_matrix(path[2].R @ a.R.T).magnitude()
    assert half == pytest.approx(Rotation.from_matrix(b.R @ a.R.T).magnitude() / 2)


@pytest.mark.parametrize(("cameras", "frames"), [(1, 5), (3, 1)])
def test_what_makes_no_path_is_refused(cameras: int, frames: int) -> None:
    with pytest.raises(ValueError, match="two cameras and two frames"):
        through(ring(cameras), frames)
