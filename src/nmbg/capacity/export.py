"""A run as small as it renders: no training state, descriptors in 8 bits, the network in bfloat16."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from safetensors.torch import load_file, save_file

from nmbg.atomic import atomic_folder
from nmbg.capacity.packing import halved, pack, unpack
from nmbg.errors import NmbgError
from nmbg.mesh import Mesh, inside
from nmbg.packed_mesh import load_packed, save_packed
from nmbg.scene import GEOMETRY, PACKED_GEOMETRY, Scene
from nmbg.training import checkpoint
from nmbg.training.run_views import VIEWS

# Steps of the vertices' grid in the scene's radius: about a sixteenth of a pixel at 1000 pixels.
GRID = 2**14


def export_compact(run: Path, output: Path, overwrite: bool = False) -> Path:
    """Write a run folder that eval loads as any other, and that is not trained further.

    Args:
        run: run folder of one scene.
        output: folder to write.
        overwrite: replace it if it exists.

    Raises:
        NmbgError: no run of one scene, or without a checkpoint.
    """
    source, config = checkpoint.load_one(run)
    found = checkpoint.latest_checkpoint(run)
    if found is None:
        raise NmbgError(f"{run}: no checkpoint yet; continue it with nmbg train --resume")
    checkpoint.load_run(run)  # what is damaged is refused before anything is written
    with atomic_folder(output, overwrite) as temporary:
        checkpoint.save_config(temporary, output, {source.name: source}, config)
        shutil.copyfile(run / VIEWS, temporary / VIEWS)
        folder = temporary / checkpoint.SCENE
        shutil.copytree(run / checkpoint.SCENE, folder)
        scene = Scene.load(folder)
        (folder / GEOMETRY).unlink(missing_ok=True)
        _save_geometry(scene, folder / PACKED_GEOMETRY, config.model.layers)
        weights = temporary / "checkpoints" / found.name
        weights.mkdir(parents=True)
        shutil.copyfile(found / "progress.json", weights / "progress.json")
        descriptors = unpack(load_file(found / "descriptors.safetensors"))
        save_file(pack(descriptors, config.model.bases), weights / "descriptors.safetensors")
        if config.model.widths:
            save_file(halved(load_file(found / "network.safetensors")), weights / "network.safetensors")
        checkpoint.load_run(temporary)
    return output


def _save_geometry(scene: Scene, path: Path, layers: int) -> None:
    """Write the geometry on its grid, each vertex on its side of the sphere between two layers."""
    mesh, step = scene.mesh, scene.radius / GRID
    save_packed(mesh, path, step)
    if layers == 1:
        return
    side = inside(mesh, scene.centre, scene.radius)
    outwards = mesh.vertices - scene.centre
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True).clip(step)
    vertices = mesh.vertices.copy()
    while (crossed := inside(load_packed(path), scene.centre, scene.radius) != side).any():
        vertices[crossed] += step * np.where(side, -1, 1)[crossed, None] * outwards[crossed]
        save_packed(Mesh(vertices, mesh.faces, mesh.colours), path, step)
