from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from nmbg.errors import NmbgError
from nmbg.mesh import Mesh, in_morton_order, load_mesh, merge, save_mesh, split_layers


def random_mesh(seed: int, n: int, m: int) -> Mesh:
    rng = np.random.default_rng(seed)
    return Mesh(
        rng.normal(size=(n, 3)).astype(np.float32),
        rng.integers(0, n, (m, 3)).astype(np.int32),
        rng.integers(0, 256, (n, 3)).astype(np.uint8),
    )


def corners(mesh: Mesh) -> set[tuple[float, ...]]:
    """Every face as its nine coordinates and nine colour values, whatever the numbering."""
    table = np.concatenate([mesh.vertices[mesh.faces], mesh.colours[mesh.faces]], axis=2)
    return {tuple(row) for row in table.reshape(len(mesh.faces), 18).tolist()}


@given(seed=st.integers(0, 10**6), n=st.integers(1, 40), m=st.integers(0, 80), radius=st.floats(0, 3))
def test_split_keeps_every_face_once_and_every_vertex(seed: int, n: int, m: int, radius: float) -> None:
    mesh = random_mesh(seed, n, m)
    centre = np.array([0.2, -0.1, 0.0])
    near, far = split_layers(mesh, centre, radius)
    assert len(near.faces) + len(far.faces) == m
    assert corners(near) | corners(far) == corners(mesh)
    assert {tuple(v) for part in (near, far) for v in part.vertices.tolist()} == {
        tuple(v) for v in mesh.vertices.tolist()
    }
    distance = np.linalg.norm(near.vertices - centre, axis=1)
    assert (distance < radius).all()
    if len(far.faces):
        outside = np.linalg.norm(far.vertices - centre, axis=1) >= radius
        assert outside[far.faces].any(axis=1).all()


def test_split_sends_lonely_vertices_by_their_position_and_duplicates_the_boundary() -> None:
    vertices = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [5, 0, 0], [0.1, 0, 0], [9, 0, 0]], np.float32)
    mesh = Mesh(vertices, np.array([[0, 1, 2], [1, 2, 3]], np.int32), np.zeros((6, 3), np.uint8))
    near, far = split_layers(mesh, np.zeros(3), 1.0)
    assert near.vertices[:, 0].tolist() == pytest.approx([0, 0.5, 0, 0.1])
    assert far.vertices[:, 0].tolist() == [0.5, 0, 5, 9]
    assert near.faces.tolist() == [[0, 1, 2]]
    assert far.faces.tolist() == [[0, 1, 2]]


@given(seed=st.integers(0, 10**6), n=st.integers(1, 40), m=st.integers(0, 80))
def test_morton_order_keeps_vertices_and_faces(seed: int, n: int, m: int) -> None:
    mesh = random_mesh(seed, n, m)
    ordered = in_morton_order(mesh)
    assert corners(ordered) == corners(mesh)
    assert sorted(ordered.vertices.tolist()) == sorted(mesh.vertices.tolist())
    first = ordered.faces.min(1) if m else np.zeros(1)
    assert (np.diff(first) >= 0).all()


def test_morton_order_visits_the_halves_of_a_cube_one_after_another() -> None:
    g = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*[np.arange(8.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    mesh = Mesh(
        g.permutation(grid).astype(np.float32), np.zeros((0, 3), np.int32), np.zeros((512, 3), np.uint8)
    )
    ordered = in_morton_order(mesh).vertices
    for eighth in ordered.reshape(8, 64, 3):
        assert np.ptp(eighth, axis=0).tolist() == [3, 3, 3]
    flat = in_morton_order(Mesh(ordered[:1], mesh.faces, mesh.colours[:1]))
    assert np.array_equal(flat.vertices, ordered[:1])


def test_merge_appends() -> None:
    first, second = random_mesh(0, 5, 4), random_mesh(1, 6, 7)
    both = merge(first, second)
    assert np.array_equal(both.vertices[5:][both.faces[4:] - 5], second.vertices[second.faces])
    assert np.array_equal(both.faces[:4], first.faces)
    assert both.faces.dtype == np.int32


def test_files_keep_every_number(tmp_path: Path) -> None:
    mesh = random_mesh(3, 50, 70)
    save_mesh(mesh, tmp_path / "mesh.ply")
    loaded, coloured = load_mesh(tmp_path / "mesh.ply")
    assert coloured
    for name in ("vertices", "faces", "colours"):
        assert np.array_equal(getattr(loaded, name), getattr(mesh, name))
        assert getattr(loaded, name).dtype == getattr(mesh, name).dtype


def test_a_mesh_without_colours_is_grey(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "ball.ply")
    mesh, coloured = load_mesh(tmp_path / "ball.ply")
    assert not coloured
    assert (mesh.colours == 128).all()


def write_ply(path: Path, vertices: list[str], faces: list[str]) -> Path:
    header = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    path.write_text("\n".join([*header, *vertices, *faces]) + "\n")
    return path


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (["0 0 0", "1 0 0", "0 1 0"], [], "no faces"),
        (["0 0 0", "1 0 0", "0 nan 0"], ["3 0 1 2"], "NaN"),
        (["0 0 0", "1 0 0", "0 inf 0"], ["3 0 1 2"], "NaN or infinite"),
        (["0 0 0", "1 0 0", "0 1 0"], ["3 0 1 7"], "do not exist"),
    ],
)
def test_unusable_meshes_are_named(
    vertices: list[str], faces: list[str], message: str, tmp_path: Path
) -> None:
    path = write_ply(tmp_path / "mesh.ply", vertices, faces)
    with pytest.raises(NmbgError, match=message) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n", b"solid nonsense"]
)
def test_damaged_mesh_files_are_named(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    path.write_bytes(content)
    with pytest.raises(NmbgError, match=r"mesh\.ply: .*--mesh"):
        load_mesh(path)


def test_an_absent_mesh_is_named(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="no such mesh file"):
        load_mesh(tmp_path / "mesh.ply")
