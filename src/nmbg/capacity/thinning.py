"""Fewer faces where a mesh holds more than pixels resolve; the far shell stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from nmbg.capacity.judge import Score
from nmbg.mesh import Mesh, in_morton_order, merge
from nmbg.scene import Scene

# What a halving may cost.
THINNING_LIMIT = Score(0.01, 0.0003)


def halved(scene: Scene) -> Scene:
    """The scene with about half of its faces, gone where they tell least of the surface.

    Edges are collapsed in order of their quadric error (Garland and Heckbert, "Surface simplification using
    quadric error metrics", 1997), by fast-simplification. Vertices take the colours of the nearest ones that
    there were.
    """
    mesh = scene.mesh
    count, vertices = len(mesh.faces) - scene.shell_faces, len(mesh.vertices) - scene.shell_vertices
    faces, shell_faces = np.split(mesh.faces, [count])
    surface = trimesh.Trimesh(mesh.vertices[:vertices], faces, process=False)
    less = surface.simplify_quadric_decimation(face_count=count // 2)
    _, nearest = cKDTree(surface.vertices).query(less.vertices)
    thinned = in_morton_order(
        Mesh(less.vertices.astype(np.float32), less.faces.astype(np.int32), mesh.colours[nearest])
    )
    shell = Mesh(mesh.vertices[vertices:], shell_faces - np.int32(vertices), mesh.colours[vertices:])
    return replace(scene, mesh=merge(thinned, shell))
