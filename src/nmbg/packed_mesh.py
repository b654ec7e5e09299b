"""Meshes in few bytes: places on a grid, and of neighbours in memory only the differences, deflated."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nmbg.errors import NmbgError
from nmbg.mesh import Mesh


def save_packed(mesh: Mesh, path: Path, step: float) -> None:
    """Write an .npz that `load_packed` reads: the same faces and colours, vertices to half a step.

    Args:
        mesh: best in Morton order, so that neighbours in memory are neighbours in space.
        path: ends in .npz.
        step: of the grid, scene units; grown where vertices lie too far apart for 32 bits.
    """
    spread = float(np.abs(mesh.vertices).max(initial=0))
    step = max(step, spread / 2**30)
    places = np.round(mesh.vertices.astype(np.float64) / step).astype(np.int32)
    np.savez_compressed(
        path,
        step=np.float64(step),
        vertices=_planes(np.diff(places, axis=0, prepend=0)),
        faces=_planes(_to_differences(mesh.faces)),
        colours=np.diff(mesh.colours, axis=0, prepend=np.uint8(0)).T,
    )


def load_packed(path: Path) -> Mesh:
    """Read what `save_packed` wrote.

    Raises:
        NmbgError: the file is damaged.
    """
    try:
        with path.open("rb") as file, np.load(file) as stored:
            places = np.cumsum(_whole(stored["vertices"]), axis=0, dtype=np.int32)
            vertices = (places * float(stored["step"])).astype(np.float32)
            faces = _from_differences(_whole(stored["faces"]))
            colours = np.cumsum(np.ascontiguousarray(stored["colours"].T), axis=0, dtype=np.uint8)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ValueError("faces name vertices that do not exist")
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise NmbgError(f"{path}: damaged geometry ({error}); export the run again") from error
    return Mesh(vertices, faces, colours)


def _to_differences(faces: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """First corners as differences between faces, the others as differences from the first."""
    first = np.diff(faces[:, :1], axis=0, prepend=0)
    return np.concatenate([first, faces[:, 1:] - faces[:, :1]], axis=1)


def _from_differences(differences: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    first = np.cumsum(differences[:, :1], axis=0, dtype=np.int32)
    return np.concatenate([first, differences[:, 1:] + first], axis=1)


def _planes(values: npt.NDArray[np.int32]) -> npt.NDArray[np.uint8]:
    """Columns [N, C] as bytes, [C, 4, N]; signs go into the lowest bit, so that high bytes are 0."""
    folded = ((values << 1) ^ (values >> 31)).astype("<u4")
    return np.ascontiguousarray(folded.T).view(np.uint8).reshape(values.shape[1], -1, 4).transpose(0, 2, 1)


def _whole(planes: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    columns = np.ascontiguousarray(planes.transpose(0, 2, 1)).view("<u4")[..., 0]
    folded = np.ascontiguousarray(columns.T)  # row by row, as kernels read: else each frame would copy it
    whole: npt.NDArray[np.int32] = (folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)
    return whole
