"""The far shell: a closed surface behind everything, for the pixels where the mesh has holes or ends.

Star-shaped around the mean training camera. In every training view the depth of uncovered pixels is filled
from the mesh around them, favouring the far side (what shows through a hole lies behind); the shell's radius
in each direction is what these depths agree on, outside the convex hull of the cameras and of what they see.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
import trimesh

from nmbg.mesh import GREY, Mesh
from nmbg.reconstruct.colours import spread
from nmbg.reconstruct.depths import Floats, fill_depth, unproject
from nmbg.reconstruct.gallery import Gallery
from nmbg.sight import look

# Of larger views every n-th pixel is used, some such many along the longer side: holes matter, not details.
FIT_SIZE = 100
# Neighbouring views see the same holes; of more than this, every n-th is used.
MOST_VIEWS = 60
# Directions of the fit: an icosphere of 2562 vertices, four degrees apart.
SUBDIVISIONS = 4
# Where views see the shell it is refined while it stays below this.
MOST_VERTICES = 40_000
# The shell keeps this distance from what it must not hide, as a factor of the radius.
CLEARANCE = 1.05
# New cameras stand beside the old ones: free space as a factor of the cameras' distance from the centre.
BEYOND_CAMERAS = 1.5


def far_shell(gallery: Gallery) -> Mesh:
    """Build the shell for the training views of a scene, behind what they see; its vertices are grey."""
    centres = np.stack([camera.centre for camera in gallery.cameras])
    centre = centres.mean(0)
    sphere = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS)
    directions, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces, dtype=np.int32)

    wanted: list[Floats] = []
    inside = [BEYOND_CAMERAS * (centres - centre)]
    fitted = range(0, len(gallery), -(-len(gallery) // MOST_VIEWS))
    for i in fitted:
        camera, _, _, depth = gallery.view(i)
        covered = depth.isfinite()
        if covered.any():
            sparse = (slice(None, None, max(1, max(covered.shape) // FIT_SIZE)),) * 2
            points = (unproject(camera, fill_depth(depth, covered)) - centre)[sparse]
            wanted.append(points[gallery.open(i).numpy()[sparse]])
            inside.append(points[covered.numpy()[sparse]])
    # Behind the hull, not only behind each point: lines of sight start at cameras, not at the centre.
    floor = CLEARANCE * _hull_radius(np.concatenate(inside), directions)
    radius, known = _cell_median(np.concatenate(wanted), directions)
    radius = np.maximum(_smooth(radius, known, faces, default=floor.max()), floor)
    shell = _mesh(centre + directions * radius[:, None], faces)
    return _refine(shell, gallery.part(fitted))


def _cells(points: Floats, directions: Floats) -> npt.NDArray[np.int64]:
    """Index of the direction [V, 3] nearest to that of each point [N, 3]."""
    grid = torch.from_numpy(directions.T.astype(np.float32))
    chunks = torch.split(torch.from_numpy(points.astype(np.float32)), 16384)
    return torch.cat([(chunk @ grid).argmax(1) for chunk in chunks]).numpy()


def _hull_radius(points: Floats, directions: Floats) -> Floats:
    """Radius in each direction of the convex hull of points [N, 3] around the origin, or a little more.

    The hull is cut out by the planes that touch it from the given directions. A segment between two of its
    points stays inside, so nothing outside can hide from a camera in the hull what lies in the hull.
    """
    chunks = torch.split(torch.from_numpy(points.astype(np.float32)), 16384)
    normals = torch.from_numpy(directions.astype(np.float32))
    support = torch.stack([(normals @ chunk.T).amax(1) for chunk in chunks]).amax(0).double().numpy()
    cosine = directions @ directions.T
    reach = np.where(cosine > 1e-3, support / np.maximum(cosine, 1e-3), np.inf)
    radius: Floats = reach.min(axis=1)
    return radius


def _cell_median(points: Floats, directions: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Median radius of the points in each direction's cell, and whether it has any."""
    cell, radius = _cells(points, directions), np.linalg.norm(points, axis=1)
    order = np.lexsort((radius, cell))
    count = np.bincount(cell, minlength=len(directions))
    start = np.cumsum(count) - count
    known = count > 0
    median = np.zeros(len(directions))
    median[known] = radius[order[start[known] + count[known] // 2]]
    return median, known


def _smooth(
    radius: Floats,
    known: npt.NDArray[np.bool_],
    faces: npt.NDArray[np.int32],
    default: float,
    rounds: int = 10,
) -> Floats:
    """Carry known radii to the unknown and even them out along edges, as logarithms: views see ratios."""
    if not known.any():
        return np.full(len(radius), default)
    sparse = np.log(np.where(known, radius, 1.0)).astype(np.float32)
    log = spread(sparse[:, None], known, faces)[:, 0].astype(np.float64)
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    degree = np.bincount(i, minlength=len(log))  # each edge of a closed surface once per direction
    for _ in range(rounds):
        log = 0.5 * log + 0.5 * np.bincount(i, weights=log[j], minlength=len(log)) / degree
    smoothed: Floats = np.exp(log)
    return smoothed


def _refine(shell: Mesh, gallery: Gallery) -> Mesh:
    """Subdivide the facets that views see, and those around them, as often as the limit allows.

    The others stay: they cost little, and a camera that looks elsewhere still finds a background. A midpoint
    lies on the edge that it halves, so facets of two sizes meet without a gap.
    """
    needed: npt.NDArray[np.bool_] = np.zeros(len(shell.faces), dtype=bool)
    for i, camera in enumerate(gallery.cameras):
        face = look(shell, camera).face[gallery.open(i)]
        needed[face[face >= 0].numpy()] = True
    for _ in range(2):
        touched = np.zeros(len(shell.vertices), dtype=bool)
        touched[shell.faces[needed]] = True
        needed = np.any(touched[shell.faces], axis=1)

    while needed.any():
        halved = np.flatnonzero(needed)
        vertices, faces = trimesh.remesh.subdivide(shell.vertices, shell.faces, halved)  # type: ignore[no-untyped-call]
        if len(vertices) > MOST_VERTICES:
            break
        kept = len(shell.faces) - len(halved)
        needed = np.arange(len(faces)) >= kept  # the new facets come last
        shell = _mesh(vertices, faces)
    return shell


def _mesh(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> Mesh:
    points = np.asarray(vertices, dtype=np.float32)
    return Mesh(points, np.asarray(faces, dtype=np.int32), np.full(points.shape, GREY, dtype=np.uint8))
