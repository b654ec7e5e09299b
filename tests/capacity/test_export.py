"""Compact runs: of two layers, of compact runs, and as a beginning."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nmbg.capacity.export import _save_geometry, export_compact
from nmbg.mesh import inside
from nmbg.packed_mesh import load_packed
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene
from nmbg.training import checkpoint
from nmbg.training.config import PRESETS
from nmbg.training.trainer import train

SPLIT = replace(PRESETS["split"], perceptual="none", iterations=2)


@pytest.fixture(scope="module")
def compact(shared_workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("compact")
    scene = preprocess(shared_workspace, home / "scene", PreprocessOptions(test_every=3, layers="2"))
    run = train(scene, SPLIT, home / "run")
    return export_compact(run, home / "small")


def test_a_vertex_at_the_sphere_keeps_its_side(scene_folder: Path, tmp_path: Path) -> None:
    """Spheres that pass closely outside and inside a vertex, for many vertices."""
    scene = Scene.load(scene_folder)
    distances = np.linalg.norm(scene.mesh.vertices - scene.centre, axis=1)
    crossed = 0
    for distance in np.sort(distances)[10:200:10]:
        for radius in (distance * (1 + 1e-7), distance * (1 - 1e-7)):
            near = replace(scene, radius=float(radius))
            _save_geometry(near, tmp_path / "plain.npz", layers=1)
            _save_geometry(near, tmp_path / "split.npz", layers=2)
            sides = inside(scene.mesh, scene.centre, radius)
            plain, split = (load_packed(tmp_path / f"{name}.npz") for name in ("plain", "split"))
            crossed += bool((inside(plain, scene.centre, radius) != sides).any())
            assert (inside(split, scene.centre, radius) == sides).all()
            assert np.abs(split.vertices - scene.mesh.vertices).max() < 4 * radius / 2**14
    assert crossed, "no sphere was near enough to tell"


def test_two_layers_are_loaded_again(compact: Path) -> None:
    run = checkpoint.load_run(compact)
    assert run.config.model.layers == 2
    assert run.renderer.render(Scene.load(run.source).test[0].camera).isfinite().all()


def test_a_compact_run_is_exported_again(compact: Path, tmp_path: Path) -> None:
    again = checkpoint.load_run(export_compact(compact, tmp_path / "again"))
    once = checkpoint.load_run(compact)
    camera = Scene.load(once.source).test[0].camera
    assert (again.renderer.render(camera) - once.renderer.render(camera)).abs().mean() < 0.01


def test_a_compact_run_is_begun_with(compact: Path, tmp_path: Path) -> None:
    once = checkpoint.load_run(compact)
    begun = train(Scene.load(once.source), replace(SPLIT, iterations=0), tmp_path / "run", init=compact)
    network = checkpoint.load_run(begun).renderer.network
    assert network is not None
    assert once.renderer.network is not None
    for mine, theirs in zip(network.parameters(), once.renderer.network.parameters(), strict=True):
        assert torch.equal(mine, theirs)
