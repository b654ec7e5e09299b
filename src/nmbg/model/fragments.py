"""What a camera sees of the geometry: rasterized once, shaded as often as training needs it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.model.config import ModelConfig
from nmbg.ops import FaceHits, rasterize_faces_pyramid, rasterize_points_pyramid


@dataclass(frozen=True)
class LevelFragments:
    """One layer at one pyramid level; indices count within the view's visible vertices and faces.

    Args:
        camera: the level's camera; its rays give the harmonics' directions.
        index: [H, W] int32 nearest point, −1 where none; None without points.
        weight: [H, W] float32 point weight.
        face: [sH, sW] int32 nearest face, −1 where none; None without faces. s is the supersampling.
        bary: [sH, sW, 3] float32 perspective-correct barycentrics.
    """

    camera: Camera
    index: Tensor | None = None
    weight: Tensor | None = None
    face: Tensor | None = None
    bary: Tensor | None = None


@dataclass(frozen=True)
class LayerFragments:
    """One layer of one view.

    Args:
        vertices: [V] int64, ascending: the layer's vertices that any level shows; None for all there are.
        faces: [F, 3] int32 into `vertices`: the faces that any level shows.
        levels: those of the pyramid that are rasterized, finest first.
        depth: [H, W] float32 view-space z at the finest level's pixel centres, 0 where no face is seen; None
            where it was not asked for.
    """

    vertices: Tensor | None
    faces: Tensor
    levels: list[LevelFragments]
    depth: Tensor | None = None

    @property
    def nbytes(self) -> int:
        """Memory held, bytes."""
        tensors = [self.faces] if self.vertices is None else [self.vertices, self.faces]
        for level in self.levels:
            tensors += [t for t in (level.index, level.weight, level.face, level.bary) if t is not None]
        return sum(t.nbytes for t in tensors)

    @property
    def empty(self) -> bool:
        """Whether no level shows anything."""
        shown = (t for level in self.levels for t in (level.index, level.face) if t is not None)
        return all(bool((t < 0).all()) for t in shown)

    def without_points(self, share: float, generator: torch.Generator) -> LayerFragments:
        """The same view with points missing at random, on all levels; nothing shows through where one was.

        Args:
            share: probability of a point to be missing.
            generator: source of the random numbers.
        """
        assert self.vertices is not None, "made for fragments that are kept"
        # Its spare last entry is what −1, no point, stays.
        kept = torch.rand(len(self.vertices) + 1, generator=generator) >= share

        def thinned(level: LevelFragments) -> LevelFragments:
            if level.index is None or level.weight is None:
                return level
            shown = kept[level.index.long()]
            index = level.index.where(shown, torch.tensor(-1, dtype=level.index.dtype))
            return replace(level, index=index, weight=level.weight * shown)

        return replace(self, levels=[thinned(level) for level in self.levels])


def rasterize_layer(
    mesh: Mesh, camera: Camera, config: ModelConfig, radius: float, once: bool = False
) -> LayerFragments:
    """Rasterize one layer for the pyramid of a camera.

    Args:
        mesh: the layer's geometry.
        camera: the view; 2^(levels − 1) divides its size.
        config: what to rasterize, and how.
        radius: of points, pixels.
        once: for fragments that are shaded once; those that are kept are rid of what no level shows.
    """
    faces = torch.from_numpy(mesh.faces)
    vertices = torch.from_numpy(mesh.vertices)
    views = [camera.level(k) for k in range(config.rasterized_levels)]
    levels = [LevelFragments(view) for view in views]
    if config.points:
        h = camera.project(vertices)
        points = rasterize_points_pyramid(h, radius, camera.height, camera.width, len(views))
        for k, (index, dist2) in enumerate(points):
            weight = 1 - dist2 / radius**2 if config.point_weight else torch.ones_like(dist2)
            levels[k] = replace(levels[k], index=index, weight=weight)
    if config.faces:
        for k, (face, bary, _) in enumerate(_see_faces(vertices, faces, camera, config, len(views))):
            levels[k] = replace(levels[k], face=face, bary=bary)
    return LayerFragments(None, faces, levels) if once else _compact(levels, faces, len(vertices))


def rasterize_finest(mesh: Mesh, camera: Camera, config: ModelConfig) -> LayerFragments:
    """The finest faces of a camera, with depth, for fragments that are shaded once.

    Args:
        mesh: the layer's geometry.
        camera: the view.
        config: what to rasterize, and how.
    """
    faces = torch.from_numpy(mesh.faces)
    vertices = torch.from_numpy(mesh.vertices)
    # Where samples are averaged, none of them stands at a pixel's centre: a coarser level's do.
    halvings = config.supersample.bit_length() - 1
    hits = _see_faces(vertices, faces, camera, config, 1 + halvings)
    level = LevelFragments(camera, face=hits[0].face, bary=hits[0].bary)
    return LayerFragments(None, faces, [level], hits[-1].depth)


def _see_faces(
    vertices: Tensor, faces: Tensor, camera: Camera, config: ModelConfig, levels: int
) -> list[FaceHits]:
    s = config.supersample
    fine = camera.resized(s * camera.width, s * camera.height)
    return rasterize_faces_pyramid(fine.project(vertices), faces, fine.height, fine.width, levels)


def _compact(levels: list[LevelFragments], faces: Tensor, n_vertices: int) -> LayerFragments:
    """Renumber what is seen from zero, so that a step costs what it sees and not what the scene holds."""
    seen_faces = _seen([level.face for level in levels], len(faces))
    shown = faces[seen_faces].long()
    seen = torch.zeros(n_vertices, dtype=torch.bool)
    seen[_seen([level.index for level in levels], n_vertices)] = True
    seen[shown.flatten()] = True
    vertices = seen.nonzero().squeeze(1)

    new_vertex = _renumber(vertices, n_vertices)
    new_face = _renumber(seen_faces, len(faces))
    compact = [
        LevelFragments(
            level.camera,
            None if level.index is None else _apply(new_vertex, level.index),
            level.weight,
            None if level.face is None else _apply(new_face, level.face),
            level.bary,
        )
        for level in levels
    ]
    return LayerFragments(vertices, new_vertex[shown].reshape(-1, 3), compact)


def _seen(indices: list[Tensor | None], count: int) -> Tensor:
    """Ascending ids that occur in the index images, [K] int64."""
    seen = torch.zeros(count + 1, dtype=torch.bool)
    for index in indices:
        if index is not None:
            seen[index.flatten().long()] = True  # −1 marks the spare last entry
    return seen[:count].nonzero().squeeze(1)


def _renumber(kept: Tensor, count: int) -> Tensor:
    """Table old id → new id, −1 for the dropped; its spare last entry maps −1 to −1."""
    table = torch.full((count + 1,), -1, dtype=torch.int32)
    table[kept] = torch.arange(len(kept), dtype=torch.int32)
    return table


def _apply(table: Tensor, index: Tensor) -> Tensor:
    return table[index.long()]
