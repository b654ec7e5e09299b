"""Geometry that is sparse, rough, torn, coarse or wrong. The far shell stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from nmbg.mesh import Mesh, merge
from nmbg.scene import Scene
from nmbg.sight import look
from stress.scenes import Random, Stress

# Radius of a region that is cut out, as a share of the sphere's.
REGION = 0.1
# A floating sheet: vertices along a side, half its side at its distance, and how far it stands along a ray.
SHEET_SIDE, SHEET_SIZE, SHEET_PLACE = 12, (0.03, 0.1), (0.3, 0.8)
# Side of the depth maps that sheets are placed by.
SIGHT_SIZE = 96


def parts(scene: Scene) -> tuple[Mesh, Mesh]:
    """The surface, and the far shell."""
    mesh, n, m = scene.mesh, _surface_size(scene), len(scene.mesh.faces) - scene.shell_faces
    surface = Mesh(mesh.vertices[:n], mesh.faces[:m], mesh.colours[:n])
    return surface, Mesh(mesh.vertices[n:], mesh.faces[m:] - np.int32(n), mesh.colours[n:])


def with_surface(scene: Scene, surface: Mesh) -> Scene:
    """The scene with another surface before its shell."""
    return replace(scene, mesh=merge(surface, parts(scene)[1]))


def _surface_size(scene: Scene) -> int:
    return len(scene.mesh.vertices) - scene.shell_vertices


def keep_vertices(mesh: Mesh, kept: npt.NDArray[np.bool_]) -> Mesh:
    """The chosen vertices [N] bool, and the faces that use no other."""
    place = np.cumsum(kept, dtype=np.int32) - 1
    faces = place[mesh.faces[kept[mesh.faces].all(1)]]
    return Mesh(mesh.vertices[kept], faces, mesh.colours[kept])


def dropped(scene: Scene, severity: float, random: Random) -> Scene:
    """A share of the vertices is gone, each by chance, and with them their faces."""
    return with_surface(
        scene, keep_vertices(parts(scene)[0], random.random(_surface_size(scene)) >= severity)
    )


def jittered(scene: Scene, severity: float, random: Random) -> Scene:
    """Vertices are moved by Gaussian noise of this deviation along each axis, a share of the radius."""
    surface, _ = parts(scene)
    noise = severity * scene.radius * random.standard_normal(surface.vertices.shape)
    return with_surface(scene, replace(surface, vertices=(surface.vertices + noise).astype(np.float32)))


def cut(scene: Scene, severity: float, random: Random) -> Scene:
    """Balls are cut out of the surface until this share of its vertices is gone."""
    surface, _ = parts(scene)
    tree, kept = cKDTree(surface.vertices), np.ones(len(surface.vertices), bool)
    for centre in random.permutation(len(kept)):
        if kept.mean() <= 1 - severity:
            break
        kept[tree.query_ball_point(surface.vertices[centre], REGION * scene.radius)] = False
    return with_surface(scene, keep_vertices(surface, kept))


def simplified(scene: Scene, severity: float, random: Random) -> Scene:
    """Vertices of a grid's cells become one, so that about one of so many is left.

    Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993.
    """
    surface, _ = parts(scene)
    if severity <= 1:
        return scene
    low, high = 1e-5 * scene.radius, 100 * scene.radius
    while high / low > 1.01:
        size = np.sqrt(low * high)
        few = len(_cells(surface, size)[1]) < len(surface.vertices) / severity
        low, high = (low, size) if few else (size, high)
    place, counts = _cells(surface, low)

    def mean(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        columns = [np.bincount(place, values[:, c], len(counts)) for c in range(3)]
        return np.stack(columns, 1) / counts[:, None]

    faces = place[surface.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    vertices, colours = mean(surface.vertices), mean(surface.colours.astype(float))
    coarse = Mesh(
        vertices.astype(np.float32), faces[np.sort(first)].astype(np.int32), colours.round().astype(np.uint8)
    )
    return with_surface(scene, coarse)


def _cells(mesh: Mesh, size: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Which cell each vertex is in, counted from 0, and how many each holds."""
    cells = np.floor((mesh.vertices - mesh.vertices.min(0)) / size).astype(np.int64)
    _, place, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return place.reshape(-1), counts


def with_sheets(scene: Scene, severity: float, random: Random) -> Scene:
    """So many sheets float between training cameras and the surface, in the colour of what is behind them."""
    surface, _ = parts(scene)
    for _ in range(round(severity)):
        surface = merge(surface, _sheet(scene, random))
    return with_surface(scene, surface)


def _sheet(scene: Scene, random: Random) -> Mesh:
    """A bumpy square before what one of the training views sees."""
    camera = scene.train[random.integers(len(scene.train))].camera.within(SIGHT_SIZE)
    sight = look(scene.mesh, camera)
    x, y, place, size = random.random(4)
    row, column = int(y * camera.height), int(x * camera.width)
    z = float(sight.depth[row, column]) or scene.radius
    centre = camera.rays(dtype=sight.depth.dtype)[row, column].numpy()
    colour = np.full(3, 128.0)
    if (face := int(sight.face[row, column])) >= 0:
        colour = scene.mesh.colours[scene.mesh.faces[face]].mean(0)
    z *= np.interp(place, (0, 1), SHEET_PLACE)
    extent = z * np.interp(size, (0, 1), SHEET_SIZE)
    middle = camera.centre + z / (centre @ camera.axis) * centre
    axes = np.linalg.qr(camera.R.T @ (np.eye(3) + 0.5 * random.standard_normal((3, 3))))[0]
    u, v = np.meshgrid(np.linspace(-1, 1, SHEET_SIDE), np.linspace(-1, 1, SHEET_SIDE))
    bump = 0.05 * random.standard_normal(u.shape)
    vertices = middle + extent * np.stack([u, v, bump], -1).reshape(-1, 3) @ axes.T
    a = (np.arange(SHEET_SIDE - 1)[:, None] * SHEET_SIDE + np.arange(SHEET_SIDE - 1)).ravel()
    b, c, d = a + 1, a + SHEET_SIDE, a + SHEET_SIDE + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
    colours = np.broadcast_to(colour.round(), vertices.shape)
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), colours.astype(np.uint8))


def points_joined(scene: Scene, severity: float, random: Random) -> Scene:
    """The faces are forgotten: every point is joined with pairs of its 6, 3 or 2 nearest others."""
    neighbours = {0: 0, 1: 6, 2: 3, 3: 2}[round(severity)]
    if not neighbours:
        return scene
    surface, _ = parts(scene)
    _, near = cKDTree(surface.vertices).query(surface.vertices, neighbours + 1)
    own = np.arange(len(near))
    pairs = [(1, j) for j in range(2, neighbours + 1)] + ([(2, 3)] if neighbours > 2 else [])
    faces = np.concatenate([np.stack([own, near[:, i], near[:, j]], 1) for i, j in pairs])
    return with_surface(scene, replace(surface, faces=faces.astype(np.int32)))


GEOMETRY = (
    Stress("vertices dropped", "geometry", "share", (0, 0.5, 0.8, 0.98), dropped),
    Stress("jitter", "geometry", "deviation, share of the radius", (0, 0.001, 0.005, 0.03), jittered),
    Stress("regions cut", "geometry", "share of the vertices", (0, 0.1, 0.3, 0.7), cut),
    Stress("simplified", "geometry", "vertices divided by", (1, 4, 16, 64), simplified),
    Stress("floating sheets", "geometry", "sheets", (0, 5, 20, 80), with_sheets),
    Stress("points only", "geometry", "joined with 6, 3, 2 nearest", (0, 1, 2, 3), points_joined),
)
