"""Which photographs a view needs: a greedy cover of what it sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.sight import look

# Longer side of the depth maps that the choice is made with, pixels.
COARSE = 96
# Points of a view that should be covered, along each side.
GRID = 20
# Depths that agree to this share show the same surface; coarse maps need more room than fine ones.
TOLERANCE = 0.05
# As in blending: radians between rays at which a source counts a sixteenth.
ANGLE = 0.1


class SourceCover:
    """Coarse depth maps of all photographs, and the choice among them.

    Args:
        mesh: the geometry.
        cameras: of the photographs.
    """

    def __init__(self, mesh: Mesh, cameras: Sequence[Camera]) -> None:
        coarse = [camera.within(COARSE) for camera in cameras]
        side = max(max(camera.width, camera.height) for camera in coarse)
        self.depth = torch.zeros(len(coarse), side, side)
        for depth, camera in zip(self.depth, coarse, strict=True):
            depth[: camera.height, : camera.width] = look(mesh, camera).depth
        self.projection = torch.from_numpy(np.stack([camera.projection for camera in coarse]))
        self.size = torch.tensor([[camera.width, camera.height] for camera in coarse])
        self.centre = torch.from_numpy(np.stack([camera.centre for camera in coarse]))

    def scores(self, points: Tensor, centre: Tensor) -> Tensor:
        """How well each photograph shows surface points to a viewer.

        Args:
            points: [P, 3] float64, world coordinates.
            centre: [3] or [P, 3] float64, of the viewer.

        Returns:
            [N, P] float64 in [0, 1], 0 where a photograph does not see a point.
        """
        h = torch.einsum("nij,pj->npi", self.projection[:, :, :3], points) + self.projection[:, None, :, 3]
        front = h[..., 2] > 0
        z = torch.where(front, h[..., 2], 1.0)
        pixel = (h[..., :2] / z[..., None]).floor()
        inside = front & ((pixel >= 0) & (pixel < self.size[:, None])).all(-1)
        x, y = torch.where(inside[..., None], pixel, 0).long().unbind(-1)
        surface = self.depth[torch.arange(len(self.depth))[:, None], y, x].double()
        seen = inside & ((z - surface).abs() < TOLERANCE * surface)
        ray = F.normalize(points - centre, dim=-1)
        cosine = (F.normalize(points - self.centre[:, None], dim=-1) * ray).sum(-1)
        angle = torch.acos(cosine.clamp(-1, 1))
        return torch.where(seen, (1 + angle / ANGLE) ** -4, 0.0)

    @staticmethod
    def points(camera: Camera, depth: Tensor) -> Tensor:
        """Surface points on a grid over a view, [P, 3] float64, where its depth [H, W] is not 0."""
        rows = torch.linspace(0.5, camera.height - 0.5, GRID).long()
        columns = torch.linspace(0.5, camera.width - 0.5, GRID).long()
        z = depth[rows[:, None], columns].double().flatten()
        pixel = torch.cartesian_prod(rows, columns).flip(1).double() + 0.5
        ray = F.pad(pixel, (0, 1), value=1.0) @ torch.from_numpy(camera.R.T @ np.linalg.inv(camera.K)).T
        return torch.from_numpy(camera.centre) + (z[:, None] * ray)[z > 0]

    def choose(
        self, camera: Camera, depth: Tensor, most: int, per_point: int, left_out: Sequence[int] = ()
    ) -> list[int]:
        """The photographs that together give the points of a view the best scores.

        Args:
            camera: the view.
            depth: [H, W] view-space z of what it sees, 0 where nothing.
            most: photographs to choose at most.
            per_point: photographs that one point uses.
            left_out: indices that may not be chosen.

        Returns:
            indices, ascending.
        """
        points = self.points(camera, depth)
        scores = self.scores(points, torch.from_numpy(camera.centre))
        scores[list(left_out)] = 0
        return sorted(greedy_cover(scores, most, per_point))


def greedy_cover(scores: Tensor, most: int, per_point: int) -> list[int]:
    """Rows that add most to the sum of each column's `per_point` best.

    Args:
        scores: [N, P], not negative.
        most: rows to choose at most.
        per_point: scores that count in a column.

    Returns:
        indices, what adds most first; those that add nothing are left out.
    """
    best = scores.new_zeros(per_point, scores.shape[1])
    chosen: list[int] = []
    for _ in range(min(most, len(scores))):
        gain = (scores - best[-1]).clamp(min=0).sum(1)
        gain[chosen] = 0
        i = int(gain.argmax())
        if not gain[i] > 0:
            break
        chosen.append(i)
        best = torch.cat([best, scores[i][None]]).sort(0, descending=True).values[:per_point]
    return chosen
