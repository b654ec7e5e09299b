"""A run as small as it renders: no training state, descriptors in 8 bits, the network in bfloat16."""

from __future__ import annotations

import shutil
from pathlib import Path

from safetensors.torch import load_file, save_file

from nmbg.atomic import atomic_folder
from nmbg.capacity.packing import halved, pack
from nmbg.errors import NmbgError
from nmbg.packed_mesh import save_packed
from nmbg.scene import GEOMETRY, PACKED_GEOMETRY, Scene
from nmbg.training import checkpoint

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
        shutil.copyfile(run / checkpoint.VIEWS, temporary / checkpoint.VIEWS)
        folder = temporary / checkpoint.SCENE
        shutil.copytree(run / checkpoint.SCENE, folder)
        scene = Scene.load(folder)
        (folder / GEOMETRY).unlink(missing_ok=True)
        save_packed(scene.mesh, folder / PACKED_GEOMETRY, scene.radius / GRID)
        weights = temporary / "checkpoints" / found.name
        weights.mkdir(parents=True)
        shutil.copyfile(found / "progress.json", weights / "progress.json")
        descriptors = load_file(found / "descriptors.safetensors")
        save_file(pack(descriptors, config.model.bases), weights / "descriptors.safetensors")
        if config.model.widths:
            save_file(halved(load_file(found / "network.safetensors")), weights / "network.safetensors")
    return output
