from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.reconstruct.colours import mean_vertex_colours, spread

# One camera at the origin that looks along z at two parallel squares; the second is hidden.
CAMERA = Camera(np.array([[20.0, 0, 16], [0, 20.0, 16], [0, 0, 1]]), np.eye(3), np.zeros(3), 32, 32)


def squares() -> Mesh:
    corners = np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(
        np.concatenate([corners, corners * [1, 1, 2]]).astype(np.float32),
        np.concatenate([faces, faces + 4]),
        np.zeros((8, 3), np.uint8),
    )


def test_a_uniform_photograph_colours_what_it_sees_and_nothing_else() -> None:
    photograph = np.full((32, 32, 3), (10, 120, 250), np.uint8)
    colours, seen = mean_vertex_colours(squares(), [(CAMERA, photograph, None)])
    assert seen.tolist() == [True] * 4 + [False] * 4
    assert np.allclose(colours[:4], (10, 120, 250), atol=1e-3)
    assert (colours[4:] == 0).all()


def test_photographs_are_averaged() -> None:
    photographs = [np.full((32, 32, 3), value, np.uint8) for value in (100, 200)]
    colours, _ = mean_vertex_colours(squares(), [(CAMERA, p, None) for p in photographs])
    assert np.allclose(colours[:4], 150, atol=1e-3)


def test_masked_pixels_do_not_count() -> None:
    photograph = np.full((32, 32, 3), 100, np.uint8)
    photograph[:, 16:] = 255
    mask = np.zeros((32, 32), bool)
    mask[:, :16] = True
    colours, seen = mean_vertex_colours(squares(), [(CAMERA, photograph, mask)])
    assert seen[:4].all()
    assert np.allclose(colours[:4], 100, atol=1e-3)


def test_each_corner_takes_the_colour_around_it() -> None:
    photograph = np.zeros((32, 32, 3), np.uint8)
    photograph[:, 16:, 0] = 255
    colours, _ = mean_vertex_colours(squares(), [(CAMERA, photograph, None)])
    left, right = colours[[0, 3], 0], colours[[1, 2], 0]
    assert left.max() + 60 < right.min()


def test_colours_spread_along_edges_in_rings() -> None:
    strip = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [5, 6, 7]], np.int32)
    values = np.array([[6], [0], [0], [0], [0], [0], [0], [0]], np.float32)
    known = np.array([True] + [False] * 7)
    assert spread(values, known, strip)[:, 0].tolist() == [6] * 8
    known[4] = True
    between = spread(values, known, strip)[:, 0]
    assert between[[0, 4]].tolist() == [6, 0]
    assert between[2] == pytest.approx(3)
    assert between[5] == pytest.approx(3), "what no edge reaches takes the mean of the known"


def test_nothing_known_changes_nothing() -> None:
    values = np.full((3, 2), 7, np.float32)
    assert (spread(values, np.zeros(3, bool), np.array([[0, 1, 2]], np.int32)) == 7).all()


@given(seed=st.integers(0, 10**6))
def test_spreading_keeps_what_is_known_and_stays_within_its_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.uniform(-5, 5, (30, 2)).astype(np.float32)
    known = rng.random(30) < 0.3
    known[0] = True
    out = spread(values, known, rng.integers(0, 30, (25, 3)).astype(np.int32))
    assert np.array_equal(out[known], values[known])
    assert (out >= values[known].min(0) - 1e-5).all()
    assert (out <= values[known].max(0) + 1e-5).all()
