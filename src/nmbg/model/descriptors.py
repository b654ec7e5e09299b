"""The memory on the mesh: spherical-harmonic coefficients per vertex (paper, section 3.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

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

    def degrees(self) -> Tensor:
        """Highest degree of each vertex whose coefficients are not all zero, [N] int64."""
        return degrees_of(self.coeffs.detach(), self.config.bases)

    def pyramid(self, fragments: LayerFragments, levels: int) -> list[Tensor]:
        """Feature images of the finest `levels` levels, [1, C, H/2ᵏ, W/2ᵏ] each: of faces, then of points.

        Args:
            fragments: the layer as one view sees it.
            levels: how many levels, finest first.
        """
        rows: Tensor = self.coeffs
        if fragments.vertices is not None:
            rows = _Rows.apply(rows, fragments.vertices.to(rows.device))  # type: ignore[no-untyped-call]
        rows = rows.view(-1, self.config.bases, self.config.features)
        images = [image[None] for image in self._shade(fragments.levels[:levels], fragments.faces, rows)]
        while len(images) < levels:
            images.append(F.avg_pool2d(images[-1], 2))
        return images

    def _shade(self, levels: Sequence[LevelFragments], faces: Tensor, rows: Tensor) -> list[Tensor]:
        """Feature images of some levels, all shaded at once: their gradient is one sum."""
        device = rows.device
        images: list[list[Tensor]] = [[] for _ in levels]
        face = [level.face for level in levels if level.face is not None]
        bary = [level.bary for level in levels if level.bary is not None]
        if face:
            s = self.config.supersample
            rays = [
                self._rays(level.camera.resized(*f.shape[::-1]))
                for level, f in zip(levels, face, strict=True)
            ]
            parts = (_row(face).to(device), _row(bary).to(device), faces.to(device), _row(rays).to(device))
            for image, shown in zip(images, _images(shade_faces(*parts, rows), face), strict=True):
                image.append(F.avg_pool2d(shown, s) if s > 1 else shown)
        index = [level.index for level in levels if level.index is not None]
        weight = [level.weight for level in levels if level.weight is not None]
        if index:
            rays = [self._rays(level.camera) for level in levels]
            points = shade_points(
                _row(index).to(device), _row(weight).to(device), _row(rays).to(device), rows
            )
            for image, shown in zip(images, _images(points, index), strict=True):
                image.append(shown)
        return [torch.cat(image) if len(image) > 1 else image[0] for image in images]

    def _rays(self, camera: Camera) -> Tensor:
        """Directions for the harmonics, [H, W, 3]; zeros for the only one of degree 0, which needs none."""
        return camera.rays() if self.config.degree else torch.zeros(camera.height, camera.width, 3)


def degrees_of(coeffs: Tensor, bases: int) -> Tensor:
    """Highest degree of each row [N, bases · features] that is not all zero, [N] int64."""
    used = (coeffs.view(len(coeffs), bases, -1) != 0).any(2)
    degree = torch.zeros(len(coeffs), dtype=torch.int64)
    for d in range(1, math.isqrt(bases)):
        degree[used[:, d * d : (d + 1) ** 2].any(1).cpu()] = d
    return degree


class _Rows(torch.autograd.Function):
    """Rows of a table, each asked for once; the gradient is sparse: the optimiser touches only these rows."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, index: Tensor) -> Tensor:
        ctx.save_for_backward(index)
        ctx.size = table.shape
        return table.index_select(0, index)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        (index,) = ctx.saved_tensors
        sparse = torch.sparse_coo_tensor(
            index[None], grad, ctx.size, is_coalesced=True, check_invariants=False
        )
        return sparse, None


def _row(images: list[Tensor]) -> Tensor:
    """Images [H, W, …] of any sizes as one of a single row, [1, pixels, …]."""
    if len(images) == 1:
        return images[0].flatten(0, 1)[None]
    return torch.cat([image.flatten(0, 1) for image in images])[None]


def _images(row: Tensor, like: list[Tensor]) -> list[Tensor]:
    """Channels of a single row, [C, 1, pixels], as images [C, H, W] of the sizes that it was joined from."""
    parts = torch.split(row[:, 0], [image.numel() for image in like], dim=1)
    return [part.view(len(part), *image.shape) for part, image in zip(parts, like, strict=True)]
