"""The demo's surfaces, tessellated as finely as one likes: objects on a round terrace.

Scene units; z is up; the terrace lies in the plane z = 0 around the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

TERRACE_RADIUS = 3.4


@dataclass(frozen=True, eq=False)
class Part:
    """One object.

    Args:
        name: picks the appearance.
        centre: [3] float64; appearance is a function of the position relative to it.
        vertices: [N, 3] float64.
        faces: [M, 3] int32, counter-clockwise from outside.
    """

    name: str
    centre: Floats
    vertices: Floats
    faces: Ints


def build_parts(edge: float) -> list[Part]:
    """All objects, with edges of about `edge` (the terrace: half as long again, twice towards its rim)."""
    return [
        _terrace(edge * 1.5),
        _blob("sphere", (0.72, 0.55, 0.5), (0.5, 0.5, 0.5), 2.0, edge),
        _blob("box", (-0.62, 0.78, 0.36), (0.42, 0.36, 0.36), 7.0, edge),
        _tube("torus", (0.62, -0.72, 0.2), _circle(0.46), (0, 0, 1), 0.2, edge),
        _tube("knot", (-0.62, -0.42, 0.74), _trefoil(0.2), (0, 1, 0), 0.13, edge),
    ]


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """Unit normals [N, 3]: the mean of the adjacent faces' normals, weighted by area."""
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(weighted[:, k], 3), len(vertices)) for k in range(3)], axis=1
    ).astype(np.float64)
    return _unit(sums)


def _blob(name: str, centre: tuple[float, ...], half: tuple[float, ...], power: float, edge: float) -> Part:
    """A superquadric |x/a|ᵖ + |y/b|ᵖ + |z/c|ᵖ = 1 over a cube's lattice: p = 2 is an ellipsoid."""
    n = max(2, round(1.7 * max(half) / edge))
    a, b = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    lattice: list[npt.NDArray[np.int64]] = []
    faces: list[Ints] = []
    for axis in range(3):
        for side in (0, n):
            points = np.insert(np.stack([a.ravel(), b.ravel()], 1), axis, side, axis=1)
            # Inserting at axis 1 turns (a, b) × normal around.
            inward = (side == 0) != (axis == 1)
            faces.append(_grid_faces(n, n, flip=inward) + len(lattice) * (n + 1) ** 2)
            lattice.append(points)
    unique, index = np.unique(np.concatenate(lattice), axis=0, return_inverse=True)
    cube = np.tan((unique / n * 2 - 1) * np.pi / 4)  # nearly equal angles
    vertices = cube / np.linalg.norm(cube, ord=power, axis=1, keepdims=True) * half + centre
    return Part(name, np.array(centre), vertices, index.reshape(-1)[np.concatenate(faces)].astype(np.int32))


def _tube(
    name: str,
    centre: tuple[float, ...],
    curve: Callable[[Floats], Floats],
    axis: tuple[float, ...],
    radius: float,
    edge: float,
) -> Part:
    """A tube around a closed curve over [0, 2π), whose tangent is never parallel to `axis`."""
    fine = curve(np.linspace(0, 2 * np.pi, 2000))
    length = np.linalg.norm(np.diff(fine, axis=0), axis=1).sum()
    along, around = max(8, round(length / edge)), max(6, round(2 * np.pi * radius / edge))
    u = np.arange(along) * 2 * np.pi / along
    v = np.arange(around) * 2 * np.pi / around
    step = 1e-4
    tangent = _unit(curve(u + step) - curve(u - step))
    side = _unit(np.cross(tangent, axis))
    top = np.cross(side, tangent)
    ring = np.cos(v)[None, :, None] * side[:, None] + np.sin(v)[None, :, None] * top[:, None]
    vertices = (curve(u)[:, None] + radius * ring).reshape(-1, 3) + centre
    faces = _grid_faces(along, around, flip=False, periodic=True)
    return Part(name, np.array(centre), vertices, faces)


def _terrace(edge: float) -> Part:
    """A disc, seen from above; its cells grow towards the rim."""
    n = round(1.35 * TERRACE_RADIUS / edge)
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    square = np.stack([x, y], -1).reshape(-1, 2)
    largest = np.abs(square).max(1, keepdims=True)
    disc = square * largest / np.maximum(np.linalg.norm(square, axis=1, keepdims=True), 1e-12)
    radius = 0.65 * largest + 0.35 * largest**3
    flat = TERRACE_RADIUS * disc * radius / np.maximum(largest, 1e-12)
    vertices = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    return Part("terrace", np.zeros(3), vertices, _grid_faces(n, n, flip=False))


def _grid_faces(n: int, m: int, flip: bool, periodic: bool = False) -> Ints:
    """Two triangles for each of n × m cells; the lattice is (n + 1) × (m + 1), or n × m when periodic."""
    i, j = (
        k.ravel()
        for k in np.meshgrid(np.arange(n, dtype=np.int32), np.arange(m, dtype=np.int32), indexing="ij")
    )
    rows, columns = (n, m) if periodic else (n + 1, m + 1)

    def vertex(row: Ints, column: Ints) -> Ints:
        return (row % rows) * columns + column % columns

    a, b, c, d = vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return faces[:, ::-1] if flip else faces


def _circle(radius: float) -> Callable[[Floats], Floats]:
    return lambda u: radius * np.stack([np.cos(u), np.sin(u), 0 * u], -1)


def _trefoil(scale: float) -> Callable[[Floats], Floats]:
    """A trefoil knot that stands upright."""

    def curve(u: Floats) -> Floats:
        x = np.sin(u) + 2 * np.sin(2 * u)
        z = np.cos(u) - 2 * np.cos(2 * u)
        y = -1.1 * np.sin(3 * u)
        return scale * np.stack([x, y, z], -1)

    return curve


def _unit(vectors: Floats) -> Floats:
    unit: Floats = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit
