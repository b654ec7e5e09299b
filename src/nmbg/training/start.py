"""Where descriptors start: what the photographs show at each vertex, in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from copy import copy

import torch
from torch import Tensor

from nmbg.images import from_bytes
from nmbg.mesh import Mesh
from nmbg.model.descriptors import SH_CONSTANT
from nmbg.ops import rasterize_faces, scatter_faces
from nmbg.ops.reference import harmonics
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View

# Ridge relative to a vertex's weight: degree 0; degrees ≥ 1, which stay small where few directions were seen.
RIDGE = (1e-4, 0.02)


def mean_colours(layers: Sequence[Mesh]) -> list[Tensor]:
    """Degree-0 coefficients [N, 1, 3] per layer that show the vertex colours."""
    return [torch.from_numpy(mesh.colours).float()[:, None] / 255 / SH_CONSTANT for mesh in layers]


class ColourFit:
    """Least-squares harmonics of the colours that views show at each vertex.

    Every pixel is an observation of its face's three vertices, weighted by the barycentrics; per vertex the
    normal equations (Σ Y Yᵀ + ridge) c = Σ Y colour are summed over the views and solved. The sums are kept
    in folds, view i in fold i modulo their number, so that any fold can be left out.

    Args:
        layers: meshes.
        scene: gives the photographs.
        views: which of them.
        bases: (degree + 1)².
        folds: how many.
        ridge: for degree 0 and for degrees ≥ 1.
        quiet: show no progress bar: another one stands around it.
    """

    def __init__(
        self,
        layers: Sequence[Mesh],
        scene: Scene,
        views: Sequence[View],
        bases: int,
        folds: int = 1,
        ridge: tuple[float, float] = RIDGE,
        quiet: bool = False,
    ) -> None:
        self.layers, self.scene, self.bases, self.folds, self.ridge = layers, scene, bases, folds, ridge
        self._fold = {view.name: i % folds for i, view in enumerate(views)}
        # Per layer, the degree of each vertex [N] int64, where it is less than what `bases` allows.
        self.degrees: list[Tensor] | None = None
        self._sums = [torch.zeros(folds, len(mesh.vertices), bases, bases + 3) for mesh in layers]
        with nullcontext() if quiet else progress_bar() as bar:
            for view in views if bar is None else bar.track(views, description="fitting colours"):
                for sums, mesh in zip(self._sums, layers, strict=True):
                    vertices, observed = self._observe(mesh, view)
                    sums[self.fold_of(view)].index_add_(0, vertices, observed)

    def fold_of(self, view: View) -> int:
        """The fold that one of the views is in."""
        return self._fold[view.name]

    def coefficients(self, without: int | None = None) -> list[Tensor]:
        """Fitted harmonics per layer, [N, bases, 3] float32.

        Args:
            without: fold to leave out. A vertex that it alone sees takes the mean of all: the mesh's own
                colour would tell what the fold shows. One that no view sees keeps the mesh's colour.
        """
        fitted = []
        for i, (sums, own) in enumerate(zip(self._sums, mean_colours(self.layers), strict=True)):
            kept = [fold for fold in range(len(sums)) if fold != without]
            otherwise = own
            if without is not None:
                told = sums[without, :, :1, :1] > 0
                otherwise = torch.where(told, own.mean(0, keepdim=True), own)
            degrees = None if self.degrees is None else self.degrees[i]
            fitted.append(self._solve(sums[kept].sum(0), otherwise, degrees))
        return fitted

    def reduced(self, degree: int) -> ColourFit:
        """The same fit with harmonics up to a degree."""
        other = copy(self)
        other.bases = (degree + 1) ** 2
        other._sums = [
            torch.cat([sums[..., : other.bases, : other.bases], sums[..., : other.bases, self.bases :]], -1)
            for sums in self._sums
        ]
        return other

    def gains(self) -> list[Tensor]:
        """What degrees take from the squared error of left-out folds: [N, 1 + highest degree] per layer.

        Means over the pixels of a vertex, against degree 0 (whose gain is 0), summed over the channels.
        """
        found = []
        for sums, own in zip(self._sums, mean_colours(self.layers), strict=True):
            whole, errors = sums.sum(0), torch.zeros(math.isqrt(self.bases), len(own))
            for fold in sums:
                for degree, error in enumerate(errors):
                    n = (degree + 1) ** 2
                    c = _solve(_lower(whole - fold, n, self.bases), own, self.ridge)
                    normal, rhs = fold[:, :n, :n], fold[:, :n, self.bases :]
                    # Σ (Y c − colour)² but for Σ colour², which all degrees have.
                    error += ((normal @ c - 2 * rhs) * c).sum((1, 2))
            weight = whole[:, 0, 0] / SH_CONSTANT**2
            found.append(((errors[0] - errors) / weight.clamp(min=1e-6)).T)
        return found

    def _solve(self, sums: Tensor, otherwise: Tensor, degrees: Tensor | None) -> Tensor:
        """Solve for the degree of each vertex; what it does not have is 0."""
        if degrees is None:
            return _solve(sums, otherwise, self.ridge)
        fitted = torch.zeros(len(sums), self.bases, 3)
        for degree in range(math.isqrt(self.bases)):
            rows, n = (degrees == degree).nonzero()[:, 0], (degree + 1) ** 2
            fitted[rows, :n] = _solve(_lower(sums[rows], n, self.bases), otherwise[rows], self.ridge)
        return fitted

    def _observe(self, mesh: Mesh, view: View) -> tuple[Tensor, Tensor]:
        """Vertices [V] that a view sees, and its sums Σ Y_b · (Y, colour) there, [V, bases, bases + 3]."""
        camera, faces = view.camera, torch.from_numpy(mesh.faces)
        rays = camera.rays()
        colour = from_bytes(self.scene.load_image(view))
        shown = torch.cat([harmonics(rays, self.bases).permute(2, 0, 1), colour])
        mask = self.scene.load_mask(view)
        if mask is not None:
            shown = shown * torch.from_numpy(mask)
        h = camera.project(torch.from_numpy(mesh.vertices))
        face, bary, _ = rasterize_faces(h, faces, camera.height, camera.width)
        seen = face >= 0
        # Renumbered to the vertices in view, so that the sums cost what is seen.
        shown_faces, pixel_face = torch.unique(face[seen], return_inverse=True)
        vertices, corners = torch.unique(faces[shown_faces.long()], return_inverse=True)
        pixel = torch.full_like(face, -1)
        pixel[seen] = pixel_face.int()
        sums = scatter_faces(shown, pixel, bary, corners.int(), rays, len(vertices), self.bases)
        return vertices.long(), sums


def _lower(sums: Tensor, n: int, bases: int) -> Tensor:
    """The normal equations [N, bases, bases + 3] of the first n harmonics alone, [N, n, n + 3]."""
    return torch.cat([sums[:, :n, :n], sums[:, :n, bases:]], dim=2)


def _solve(sums: Tensor, otherwise: Tensor, ridge: tuple[float, float]) -> Tensor:
    """Solve per vertex for the deviation from its mean colour; one without observations shows `otherwise`."""
    bases = sums.shape[1]
    normal, rhs = sums[..., :bases], sums[..., bases:]
    weight = normal[:, :1, :1] / SH_CONSTANT**2
    mean = torch.where(weight > 0, rhs[:, :1] / SH_CONSTANT**2 / weight.clamp(min=1e-12), otherwise)
    diagonal = torch.diag(torch.tensor([ridge[0]] + [ridge[1]] * (bases - 1)))
    regular = normal + diagonal * (weight + 1e-6)
    fitted: Tensor = torch.cholesky_solve(rhs - normal[..., :1] @ mean, torch.linalg.cholesky(regular))
    fitted[:, :1] += mean
    return fitted
