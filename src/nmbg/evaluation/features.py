"""What a model rasterizes before anything is made of it, as pictures (paper, figures 2 and 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.images import Image, to_bytes
from nmbg.model.descriptors import Descriptors
from nmbg.model.fragments import LayerFragments
from nmbg.model.renderer import Renderer


@dataclass(frozen=True)
class Panel:
    """One kind of features of one layer.

    Args:
        title: which.
        features: [H, W, 3] uint8.
        occupancy: [H, W] uint8, bright where there are any.
    """

    title: str
    features: Image
    occupancy: Image


@torch.no_grad()
def feature_panels(renderer: Renderer, camera: Camera, without: str = "") -> list[Panel]:
    """The finest features of a view, per layer and kind.

    Of a model that blends photographs these are the photographs and the mesh. Colours are shown as they are,
    other features by their three principal components.

    Args:
        renderer: the model.
        camera: the view.
        without: name of the photograph that must not be blended in.
    """
    if renderer.photographs is not None:
        base, depth = renderer.on_mesh(camera)
        gathered = renderer.photographs.gather(camera, base, depth, {without})
        return [
            Panel("mesh, colours", to_bytes(base), _grey(depth > 0)),
            Panel("photographs, blended over the mesh", to_bytes(gathered.blended()), _grey(gathered.trust)),
        ]
    names = ("foreground", "background") if len(renderer.layers) > 1 else ("mesh",)
    panels = []
    for name, layer, descriptors in zip(names, renderer.rasterize(camera), renderer.descriptors, strict=True):
        (image,) = cast("Descriptors", descriptors).pyramid(layer, 1)
        for kind, features, mask in _kinds(image[0], layer, renderer.config.features):
            crop = (..., slice(camera.height), slice(camera.width))
            features, mask = features[crop].cpu(), mask[crop]
            shown = (
                to_bytes(features + 0.5)
                if renderer.config.features == 3
                else principal_colours(features, mask > 0)
            )
            panels.append(Panel(f"{name}, {kind}", shown, _grey(mask)))
    return panels


def principal_colours(features: Tensor, mask: Tensor) -> Image:
    """Three principal components as red, green and blue, each from its 2nd to its 98th percentile.

    Args:
        features: [C, H, W] float, C ≥ 3.
        mask: [H, W] bool: the pixels that count; the others are black.

    Returns:
        [H, W, 3] uint8.
    """
    image = np.zeros((*mask.shape, 3), dtype=np.uint8)
    rows = features.permute(1, 2, 0)[mask].double()
    if not len(rows):
        return image
    centred = rows - rows.mean(0)
    directions = torch.linalg.eigh(centred.T @ centred).eigenvectors[:, -3:].flip(1)
    directions = directions * directions.gather(0, directions.abs().argmax(0, keepdim=True)).sign()
    projected = (centred @ directions).numpy()
    low, high = np.percentile(projected, (2, 98), axis=0)
    image[mask.numpy()] = (255 * ((projected - low) / (high - low).clip(1e-12)).clip(0, 1)).round()
    return image


def _kinds(image: Tensor, layer: LayerFragments, count: int) -> list[tuple[str, Tensor, Tensor]]:
    """Name, features [count, H, W] and occupancy [H, W] of the faces and the points of one layer's image."""
    level, kinds = layer.levels[0], []
    if level.face is not None:
        covered = (level.face >= 0).float()
        s = level.face.shape[0] // level.camera.height
        kinds.append(("faces", image[:count], F.avg_pool2d(covered[None], s)[0] if s > 1 else covered))
        image = image[count:]
    if level.index is not None and len(image):
        kinds.append(("points", image[:count], (level.index >= 0).float()))
    return kinds


def _grey(mask: Tensor) -> Image:
    pixels: Image = (mask.float() * 255).round().byte().contiguous().numpy()
    return pixels
