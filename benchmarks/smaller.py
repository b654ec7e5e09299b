"""A scene made smaller: fewer vertices, or smaller training photographs; held-out views stay as they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from nmbg.atomic import atomic_folder
from nmbg.images import resize, write_image
from nmbg.mesh import Mesh, merge
from nmbg.scene import Scene


def smaller_scene(folder: Path, output: Path, vertices: float = 1.0, images: float = 1.0) -> Path:
    """Write a smaller scene beside others; one that is there is kept.

    Args:
        folder: the scene.
        output: where smaller scenes go.
        vertices: share of the surface's vertices that is left, about.
        images: factor of the sides of the training photographs.

    Returns:
        the smaller scene's folder; `folder` itself where nothing is made smaller.
    """
    if vertices == images == 1:
        return folder
    target = output / f"{folder.name}-vertices{vertices:g}-images{images:g}"
    if target.exists():
        return target
    scene = Scene.load(folder)
    views = []
    with atomic_folder(target) as temporary:
        (temporary / "images").mkdir()
        (temporary / "masks").mkdir()
        for view in scene.views:
            scale = images if view.split == "train" else 1.0
            width, height = (max(1, round(scale * side)) for side in (view.camera.width, view.camera.height))
            write_image(temporary / "images" / view.image, resize(scene.load_image(view), width, height))
            mask = scene.load_mask(view)
            if mask is not None and view.mask is not None:
                shown = resize(255 * mask[..., None].astype(np.uint8), width, height)[..., 0]
                write_image(temporary / "masks" / view.mask, shown)
            views.append(replace(view, camera=view.camera.resized(width, height)))
        replace(scene, mesh=_thinned(scene, vertices), views=tuple(views)).save(temporary)
    return target


def _thinned(scene: Scene, share: float) -> Mesh:
    """One vertex stays of those in a cell of a grid; the far shell stays as it is."""
    mesh = scene.mesh
    if share == 1:
        return mesh
    n, m = len(mesh.vertices) - scene.shell_vertices, len(mesh.faces) - scene.shell_faces
    shell = Mesh(mesh.vertices[n:], mesh.faces[m:] - np.int32(n), mesh.colours[n:])
    low, high = 1e-5 * scene.radius, 10 * scene.radius
    while high / low > 1.02:
        size = np.sqrt(low * high)
        first = np.unique(np.round(mesh.vertices[:n] / size), axis=0, return_index=True)[1]
        low, high = (low, size) if len(first) < share * n else (size, high)
    _, first, place = np.unique(
        np.round(mesh.vertices[:n] / low), axis=0, return_index=True, return_inverse=True
    )
    faces = place.reshape(-1)[mesh.faces[:m]]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return merge(Mesh(mesh.vertices[first], faces[whole].astype(np.int32), mesh.colours[first]), shell)
