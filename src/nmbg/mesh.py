"""Triangle meshes: one vertex set, rasterized as points and through its faces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh

from nmbg.errors import NmbgError

# What a vertex looks like that nobody gave a colour.
GREY = 128


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh with a colour per vertex.

    Args:
        vertices: [N, 3] float32, scene units.
        faces: [M, 3] int32.
        colours: [N, 3] uint8.
    """

    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    colours: npt.NDArray[np.uint8]


def empty_mesh() -> Mesh:
    """A mesh of nothing."""
    return Mesh(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3), np.uint8))


def load_mesh(path: Path) -> tuple[Mesh, bool]:
    """Read a mesh file: PLY, OBJ, OFF, GLB, whatever trimesh reads; polygons become triangles.

    Returns:
        the mesh, and whether the file holds colours per vertex (else they are grey).

    Raises:
        NmbgError: absent, unreadable, without faces, with NaN or infinite vertices, or with faces that name
            vertices that do not exist.
    """
    if not path.is_file():
        raise NmbgError(f"{path}: no such mesh file; give one with --mesh")
    try:
        loaded = trimesh.load(path, process=False, force="mesh")
    except Exception as error:  # trimesh raises whatever its many parsers raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise NmbgError(f"{path}: not a readable mesh ({reason}); give another with --mesh") from error
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise NmbgError(f"{path}: has no faces; mesh the points first, or give a surface mesh with --mesh")
    vertices = np.asarray(loaded.vertices, dtype=np.float32)
    faces = np.asarray(loaded.faces)
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(1).sum())
        raise NmbgError(f"{path}: {bad} of {len(vertices)} vertices are NaN or infinite; repair the mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise NmbgError(
            f"{path}: faces name vertices that do not exist; the file is damaged, export it again"
        )
    visual = loaded.visual
    coloured = isinstance(visual, trimesh.visual.ColorVisuals) and visual.kind == "vertex"
    if isinstance(visual, trimesh.visual.ColorVisuals) and coloured:
        colours = np.asarray(visual.vertex_colors, dtype=np.uint8)[:, :3].copy()
    else:
        colours = np.full(vertices.shape, GREY, dtype=np.uint8)
    return Mesh(vertices, np.ascontiguousarray(faces, dtype=np.int32), colours), coloured


def save_mesh(mesh: Mesh, path: Path) -> None:
    """Write a binary PLY with colours; `load_mesh` gives back the same numbers."""
    alpha = np.full((len(mesh.colours), 1), 255, dtype=np.uint8)
    out = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    out.visual = trimesh.visual.ColorVisuals(out, vertex_colors=np.concatenate([mesh.colours, alpha], axis=1))
    path.write_bytes(trimesh.exchange.ply.export_ply(out, encoding="binary"))


def merge(first: Mesh, second: Mesh) -> Mesh:
    """Both meshes as one: the vertices and faces of `second` come after those of `first`."""
    return Mesh(
        np.concatenate([first.vertices, second.vertices]),
        np.concatenate([first.faces, second.faces + np.int32(len(first.vertices))]),
        np.concatenate([first.colours, second.colours]),
    )


def in_morton_order(mesh: Mesh) -> Mesh:
    """The same mesh with vertices sorted along a Morton curve, and faces by their first vertex on it.

    What is close in space is then close in memory, whatever order the mesh came in (Morton, "A computer
    oriented geodetic data base", 1966).
    """
    if not len(mesh.vertices):
        return mesh
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    extent = np.maximum(high - low, np.finfo(np.float32).tiny).astype(np.float64)
    cells = ((mesh.vertices - low) / extent * (2**21 - 1)).astype(np.uint64)
    order = np.argsort(np.bitwise_or.reduce(_every_third_bit(cells) << np.arange(3, dtype=np.uint64), axis=1))
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    faces = place[mesh.faces]
    by_place = np.argsort(faces.min(1), kind="stable")
    return Mesh(mesh.vertices[order], faces[by_place], mesh.colours[order])


def _every_third_bit(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Spread the lowest 21 bits of each number, two zeros between them."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | x << np.uint64(shift)) & np.uint64(mask)
    return x


def split_layers(mesh: Mesh, centre: npt.NDArray[np.float64], radius: float) -> tuple[Mesh, Mesh]:
    """Foreground and background of a mesh, cut at a sphere along whole faces.

    A face is foreground when all its vertices lie inside the sphere, else background. Vertices that both need
    are duplicated; a vertex without a face goes by its own position.

    Args:
        mesh: the whole.
        centre: of the sphere, [3], scene units.
        radius: of the sphere, scene units.

    Returns:
        (foreground, background): together every face exactly once, in the mesh's order.
    """
    near = inside(mesh, centre, radius)
    foreground = np.logical_and.reduce(near[mesh.faces], axis=1)
    lonely = np.ones(len(mesh.vertices), dtype=bool)
    lonely[mesh.faces] = False
    return (
        _part(mesh, foreground, lonely & near),
        _part(mesh, ~foreground, lonely & ~near),
    )


def inside(mesh: Mesh, centre: npt.NDArray[np.float64], radius: float) -> npt.NDArray[np.bool_]:
    """Which vertices lie inside a sphere, [N] bool; centre [3] and radius in scene units."""
    near: npt.NDArray[np.bool_] = np.linalg.norm(mesh.vertices - centre, axis=1) < radius
    return near


def drop_unused(mesh: Mesh, keep_faces: npt.NDArray[np.bool_]) -> Mesh:
    """The chosen faces [M] bool, and only the vertices that they use."""
    return _part(mesh, keep_faces, np.zeros(len(mesh.vertices), dtype=bool))


def _part(mesh: Mesh, keep_faces: npt.NDArray[np.bool_], keep_vertices: npt.NDArray[np.bool_]) -> Mesh:
    faces = mesh.faces[keep_faces]
    used = keep_vertices.copy()
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return Mesh(mesh.vertices[used], renumbered[faces].astype(np.int32), mesh.colours[used])
