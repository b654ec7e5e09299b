from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmbg.errors import NmbgError
from nmbg.mesh import Mesh, empty_mesh
from nmbg.packed_mesh import load_packed, save_packed


def random_mesh(n: int, m: int, seed: int, scale: float) -> Mesh:
    rng = np.random.default_rng(seed)
    return Mesh(
        rng.normal(0, scale, (n, 3)).astype(np.float32),
        rng.integers(0, n, (m, 3)).astype(np.int32),
        rng.integers(0, 256, (n, 3)).astype(np.uint8),
    )


@given(
    n=st.integers(1, 40), m=st.integers(0, 40), seed=st.integers(0, 99), scale=st.sampled_from([0.1, 1.0, 50])
)
def test_faces_and_colours_come_back_and_vertices_to_half_a_step(
    tmp_path_factory: pytest.TempPathFactory, n: int, m: int, seed: int, scale: float
) -> None:
    mesh, path = random_mesh(n, m, seed, scale), tmp_path_factory.mktemp("packed") / "mesh.npz"
    save_packed(mesh, path, step=0.01)
    loaded = load_packed(path)
    assert np.array_equal(loaded.faces, mesh.faces)
    assert np.array_equal(loaded.colours, mesh.colours)
    assert np.abs(loaded.vertices - mesh.vertices).max() <= 0.005 * (1 + 1e-3)
    # As kernels read them: otherwise every frame copies them first.
    assert loaded.vertices.flags.c_contiguous
    assert loaded.faces.flags.c_contiguous


def test_an_empty_mesh(tmp_path: Path) -> None:
    save_packed(empty_mesh(), tmp_path / "mesh.npz", step=1.0)
    assert len(load_packed(tmp_path / "mesh.npz").faces) == 0


def test_damaged_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "mesh.npz"
    save_packed(random_mesh(50, 50, 0, 1.0), path, step=0.01)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(NmbgError, match=r"mesh\.npz"):
        load_packed(path)
