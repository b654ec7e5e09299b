"""Moving the surface to where the photographs agree about it.

Every photograph is predicted from the others over the surface moved by a few steps along its normals, to both
sides; each vertex takes the step at which the errors around it are least. A sweep, because the error is no
smooth function of an outline: gradients of the rasterized depth end there, and outlines gain most. The errors
of all steps are charged to the vertices that the unmoved surface shows in these pixels, so that what a moved
outline takes from its background counts as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
import trimesh
from torch import Tensor

from nmbg.blending import blend_into
from nmbg.images import resize
from nmbg.mesh import Mesh
from nmbg.model.cover import SourceCover
from nmbg.model.photographs import CANDIDATES
from nmbg.ops import mip_chain, rasterize_faces, scatter_faces
from nmbg.progress import progress_bar
from nmbg.reconstruct.coverage import mask_at
from nmbg.scene import Scene, evenly
from nmbg.sight import look

# Longer side at which photographs are compared, pixels.
SIZE = 640
# So many views at most, spread over the capture; fewer where the budget is short.
MOST_VIEWS, LEAST_VIEWS, VIEWS_A_MINUTE = 72, 12, 30
# Photographs blended in a pixel.
SOURCES = 5
# Steps along the normals that are tried in a round.
STEPS = (-3, -2, -1, 0, 1, 2, 3)
# What a step must gain, as a share of the unmoved surface's error: errors also differ by chance, more so
# where they are large. Below the second, in [0, 1], they are no evidence.
STEP_COST, LEAST_ERROR = 0.02, 0.01
# Error where no other photograph sees the surface, and the score at which that counts half.
UNSEEN, HALF_TRUST = 0.2, 1e-4
# Rounds of means that keep the steps of neighbouring vertices alike.
EVENNESS = 3


@dataclass(frozen=True)
class Sweep:
    """One round.

    Args:
        pixels: how far a step moves a surface seen from its side, pixels of the nearest view.
        window: side of the window over which errors are averaged, pixels.
        smoothing: rounds of means over neighbouring vertices.
    """

    pixels: float
    window: int
    smoothing: int


SWEEPS = (Sweep(0.75, 7, 20), Sweep(0.4, 5, 10))

Array = npt.NDArray[np.float64]


def views_for(minutes: float | None) -> int:
    """How many views may judge within a budget of minutes: about a third of it, on two cores."""
    return (
        MOST_VIEWS if minutes is None else min(MOST_VIEWS, max(LEAST_VIEWS, round(VIEWS_A_MINUTE * minutes)))
    )


def refine_geometry(scene: Scene, sweeps: Sequence[Sweep] = SWEEPS, views: int = MOST_VIEWS) -> Mesh:
    """The scene's mesh with its vertices moved along their normals; the far shell stays where it is.

    Args:
        scene: only its training views are read.
        sweeps: the coarsest first.
        views: so many at most judge.
    """
    mesh, judge = scene.mesh, _Judge(scene, views)
    neighbours = _Neighbours(mesh)
    with progress_bar() as bar:
        task = bar.add_task("refining geometry", total=len(sweeps) * len(STEPS))
        for sweep in sweeps:
            unit = sweep.pixels * judge.pixel_sizes(mesh)
            unit[len(unit) - scene.shell_vertices :] = 0
            normals = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).vertex_normals
            sources, errors = judge.sources(mesh), []
            for step in STEPS:
                errors.append(judge.errors(_moved(mesh, step * unit, normals), sources))
                bar.advance(task)
            charged = judge.charge(mesh, list(zip(*errors, strict=True)), sweep.window)
            steps = _best_steps(charged, neighbours, sweep.smoothing)
            mesh = _moved(mesh, steps * unit, normals)
    return mesh


def _moved(mesh: Mesh, distance: Array, normals: Array) -> Mesh:
    return replace(mesh, vertices=(mesh.vertices + distance[:, None] * normals).astype(np.float32))


class _Neighbours:
    """Means over every vertex and those that it shares an edge with."""

    def __init__(self, mesh: Mesh) -> None:
        edges = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).edges_unique
        itself = np.arange(len(mesh.vertices))
        pairs = np.concatenate([edges, edges[:, ::-1], np.stack([itself, itself], 1)])
        pairs = pairs[np.lexsort(pairs.T[::-1])]
        self.other = pairs[:, 1]
        self.first = np.searchsorted(pairs[:, 0], itself)
        self.count = np.diff(self.first, append=len(pairs)).astype(np.float64)

    def mean(self, values: Array, rounds: int) -> Array:
        """Values [N, C] after some rounds of means."""
        for _ in range(rounds):
            values = np.add.reduceat(values[self.other], self.first) / self.count[:, None]
        return values


def _best_steps(charged: Array, neighbours: _Neighbours, smoothing: int) -> Array:
    """The step of each vertex, between the tried ones where the errors say so.

    Args:
        charged: [N, steps + 1], per vertex the sum of errors of each step, and their weight.
        neighbours: of the vertices.
        smoothing: rounds of means before the choice.

    Returns:
        [N]; 0 where no view sees anything.
    """
    charged = neighbours.mean(charged, smoothing)
    weight = charged[:, -1:]
    steps = np.array(STEPS, dtype=np.float64)
    error = charged[:, :-1] / np.maximum(weight, 1e-6)
    still = np.maximum(error[:, STEPS.index(0)], LEAST_ERROR)[:, None]
    cost = error / still + STEP_COST * np.abs(steps)
    best = cost.argmin(1)
    # The vertex of a parabola through the best step and its neighbours.
    middle = best.clip(1, len(steps) - 2)
    before, at, after = (cost[np.arange(len(cost)), middle + i] for i in (-1, 0, 1))
    bend = np.maximum(before - 2 * at + after, 1e-12)
    between = np.where(best == middle, (0.5 * (before - after) / bend).clip(-0.5, 0.5), 0.0)
    chosen = np.where(weight[:, 0] > 1e-6, steps[best] + between, 0.0)
    return neighbours.mean(chosen[:, None], EVENNESS)[:, 0]


class _Judge:
    """Training photographs, each of which is predicted from the others over any surface."""

    def __init__(self, scene: Scene, most: int) -> None:
        views = evenly(scene.train, most)
        self.cameras = [view.camera.within(SIZE) for view in views]
        self.images: list[Tensor] = []  # [3, H, W] in [0, 1]
        self.masks: list[Tensor] = []  # [H, W] bool
        self.texels: list[Tensor] = []
        for view, camera in zip(views, self.cameras, strict=True):
            image = torch.from_numpy(resize(scene.load_image(view), camera.width, camera.height))
            mask = torch.from_numpy(mask_at(scene.load_mask(view), camera))
            self.images.append(image.permute(2, 0, 1) / 255)
            self.masks.append(mask)
            self.texels.append(mip_chain(image, mask))

    def pixel_sizes(self, mesh: Mesh) -> Array:
        """What a pixel spans at each vertex in the view that is nearest to it, [N] scene units."""
        points = torch.from_numpy(mesh.vertices)
        sizes = torch.full((len(points),), torch.inf)
        for camera in self.cameras:
            u, v, z = camera.project(points).unbind(1)
            inside = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width * z) & (v < camera.height * z)
            sizes = torch.where(inside, sizes.minimum(z / camera.K[0, 0]), sizes)
        return torch.where(sizes.isinf(), 0, sizes).double().numpy()

    def sources(self, mesh: Mesh) -> list[list[int]]:
        """Per view, the other views that it is predicted from."""
        cover = SourceCover(mesh, self.cameras)
        return [
            cover.choose(camera, look(mesh, camera).depth, CANDIDATES, SOURCES, [i])
            for i, camera in enumerate(self.cameras)
        ]

    def errors(self, mesh: Mesh, sources: Sequence[Sequence[int]]) -> list[Tensor]:
        """Per view, root mean square difference of the photographs blended into it, [H, W]."""
        depths = [
            look(mesh, camera).depth * mask for camera, mask in zip(self.cameras, self.masks, strict=True)
        ]
        return [self._error(i, others, depths) for i, others in enumerate(sources)]

    def _error(self, i: int, others: Sequence[int], depths: Sequence[Tensor]) -> Tensor:
        blend = blend_into(
            self.cameras[i],
            depths[i],
            [self.cameras[j] for j in others],
            [self.texels[j] for j in others],
            [depths[j] for j in others],
            SOURCES,
        )
        trust = blend.weight / (blend.weight + HALF_TRUST)
        # Of the single sources, not of their mean: that would gain by blurring what disagrees.
        square = (blend.colour - self.images[i]).square().mean(0) + blend.variance
        return trust * square.sqrt() + (1 - trust) * UNSEEN

    def charge(self, mesh: Mesh, errors: Sequence[Sequence[Tensor]], window: int) -> Array:
        """Charge errors to the vertices that the views see, [N, steps + 1]: sum per step, and weight.

        Args:
            mesh: the surface that is charged.
            errors: per view and step, [H, W].
            window: side of the window over which they are averaged before, pixels.
        """
        vertices, faces = torch.from_numpy(mesh.vertices), torch.from_numpy(mesh.faces)
        sums = torch.zeros(len(vertices), len(errors[0]) + 1, dtype=torch.float64)
        for camera, mask, steps in zip(self.cameras, self.masks, errors, strict=True):
            counted = torch.stack([*steps, torch.ones_like(steps[0])]) * mask
            mean = F.avg_pool2d(counted, window, 1, window // 2)
            pixels = mean / mean[-1].clamp(min=1e-6) * mask
            face, bary, _ = rasterize_faces(camera.project(vertices), faces, camera.height, camera.width)
            rays = torch.zeros_like(bary)  # harmonics of degree 0 do not ask for a direction
            sums += scatter_faces(pixels, face, bary, faces, rays, len(vertices), 1)[:, 0]
        return sums.numpy()
