"""The memory on the mesh: spherical-harmonic coefficients per vertex (paper, section 3.2)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nmbg.cameras import Camera
from nmbg.model.config import ModelConfig
from nmbg.model.fragments import LayerFragments, LevelFragments
from nmbg.ops import shade_faces, shade_points

SH_CONSTANT = 0.28209479177387814  # Y_00


class Descriptors(nn.Module):
    """The descriptors of one layer and how they are shown.

    Args:
        count: number of vertices.
        config: features, degree, and what is rasterized.
    """

    def __init__(self, count: int, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.coeffs = nn.Parameter(torch.zeros(count, config.bases * config.features))

    @torch.no_grad()
    def set_colours(self, coeffs: Tensor) -> None:
        """Set the first three features, colour − ½, from coefficients [N, B′, 3] of any lower degree."""
        table = self.coeffs.view(len(self.coeffs), self.config.bases, self.config.features)
        bases = min(coeffs.shape[1], self.config.bases)
        table[:, :bases, :3] = coeffs[:, :bases].to(table)

    def pyramid(self, fragments: LayerFragments, levels: int, channels: slice) -> list[Tensor]:
        """Feature images of the finest `levels` levels, [1, channels, H/2ᵏ, W/2ᵏ] each.

        Args:
            fragments: the layer as one view sees it.
            levels: how many levels, finest first.
            channels: which features to show; the mask channel comes only with all of them.
        """
        rows: Tensor = self.coeffs
        if fragments.vertices is not None:
            # A gather with a sparse gradient: the optimiser touches only the vertices that this view sees.
            rows = F.embedding(fragments.vertices.to(self.coeffs.device), self.coeffs, sparse=True)
        rows = rows.view(-1, self.config.bases, self.config.features)[:, :, channels]
        images = [self._shade(level, fragments.faces, rows)[None] for level in fragments.levels[:levels]]
        while len(images) < levels:
            images.append(F.avg_pool2d(images[-1], 2))
        return images

    def _shade(self, level: LevelFragments, faces: Tensor, rows: Tensor) -> Tensor:
        images = []
        device, whole = rows.device, rows.shape[2] == self.config.features
        if level.index is not None and level.weight is not None and whole:
            rays = self._rays(level.camera).to(device)
            images.append(shade_points(level.index.to(device), level.weight.to(device), rays, rows))
        if level.face is not None and level.bary is not None:
            s = self.config.supersample
            height, width = level.face.shape
            rays = self._rays(level.camera.resized(width, height)).to(device)
            face = level.face.to(device)
            image = shade_faces(face, level.bary.to(device), faces.to(device), rays, rows)
            # Faces come first: the colour skip reads the first three channels.
            images.insert(0, F.avg_pool2d(image, s) if s > 1 else image)
        if self.config.mask_channel and whole:
            images.append(self._mask(level, device))
        return torch.cat(images) if len(images) > 1 else images[0]

    def _rays(self, camera: Camera) -> Tensor:
        """Directions for the harmonics, [H, W, 3]; zeros for the only one of degree 0, which needs none."""
        return camera.rays() if self.config.degree else torch.zeros(camera.height, camera.width, 3)

    def _mask(self, level: LevelFragments, device: torch.device) -> Tensor:
        index = level.face if level.face is not None else level.index
        assert index is not None
        mask = (index >= 0).float()[None].to(device)
        s = index.shape[0] // level.camera.height
        return F.avg_pool2d(mask, s) if s > 1 else mask
