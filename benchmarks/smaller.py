"""A scene made smaller: fewer vertices, or smaller training photographs; held-out views stay as they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from stress.geometry import simplified

from nmbg.atomic import atomic_folder
from nmbg.images import resize, write_image
from nmbg.scene import Scene

NOTHING_RANDOM = np.random.default_rng(0)  # simplifying uses none


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
        simplified(replace(scene, views=tuple(views)), 1 / vertices, NOTHING_RANDOM).save(temporary)
    return target
