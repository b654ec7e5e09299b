"""Fewer faces where a mesh holds more than pixels resolve; the far shell stays as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import fast_simplification
import numpy as np
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

from nmbg.capacity.judge import Limit
from nmbg.mesh import Mesh, in_morton_order, merge
from nmbg.scene import Scene, View
from nmbg.sight import look

# What a halving may cost.
THINNING_LIMIT = Limit(0.01, 0.003)
# Share of a view's pixels that may lose the surface, but for those so near to its outlines.
OPENED, OUTLINE = 0.0005, 2


def covered(scene: Scene, view: View) -> Tensor:
    """Where a view shows the surface, [H, W] bool; the far shell does not count."""
    face = look(scene.mesh, view.camera).face
    return (face >= 0) & (face < len(scene.mesh.faces) - scene.shell_faces)


def opened(scene: Scene, thinner: Scene, views: Sequence[View]) -> float:
    """The largest share of a view's pixels that lose the surface, outlines left out: these move."""
    shares = []
    for view in views:
        inner = -F.max_pool2d(-covered(scene, view)[None].float(), 2 * OUTLINE + 1, 1, OUTLINE)[0] > 0
        shares.append(float((inner & ~covered(thinner, view)).float().mean()))
    return max(shares)


def halved(scene: Scene) -> Scene:
    """The scene with about half of its faces, gone where they tell least of the surface.

    Edges are collapsed in order of their quadric error (Garland and Heckbert, "Surface simplification using
    quadric error metrics", 1997), by fast-simplification. Vertices take the colours of the nearest ones that
    there were.
    """
    mesh = scene.mesh
    count, vertices = len(mesh.faces) - scene.shell_faces, len(mesh.vertices) - scene.shell_vertices
    faces, shell_faces = np.split(mesh.faces, [count])
    # Borders stay: two that lie on one another would part.
    places, corners, *_ = fast_simplification.simplify(
        mesh.vertices[:vertices], faces, target_count=count // 2, preserve_border=True
    )
    _, nearest = cKDTree(mesh.vertices[:vertices]).query(places)
    thinned = in_morton_order(
        Mesh(places.astype(np.float32), corners.astype(np.int32), mesh.colours[nearest])
    )
    shell = Mesh(mesh.vertices[vertices:], shell_faces - np.int32(vertices), mesh.colours[vertices:])
    return replace(scene, mesh=merge(thinned, shell))
