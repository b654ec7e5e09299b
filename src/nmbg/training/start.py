"""Where descriptors start: what the photographs show at each vertex, in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from nmbg.mesh import Mesh
from nmbg.model.descriptors import SH_CONSTANT
from nmbg.ops import rasterize_faces, shade_faces
from nmbg.ops.reference import harmonics
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View

# Ridge relative to a vertex's weight: degree 0; degrees ≥ 1, which stay small where few directions were seen.
RIDGE = (1e-4, 0.02)


def mean_colours(layers: Sequence[Mesh]) -> list[Tensor]:
    """Degree-0 coefficients [N, 1, 3] per layer that show the vertex colours."""
    return [torch.from_numpy(mesh.colours).float()[:, None] / 255 / SH_CONSTANT for mesh in layers]


def fitted_colours(
    layers: Sequence[Mesh],
    scene: Scene,
    views: Sequence[View],
    bases: int,
    ridge: tuple[float, float] = RIDGE,
) -> list[Tensor]:
    """Least-squares harmonics of the colours that the views show at each vertex.

    Every pixel is an observation of its face's three vertices, weighted by the barycentrics; per vertex the
    normal equations (Σ Y Yᵀ + ridge) c = Σ Y colour are summed over the views and solved. The sums are
    gradients of shading: its backward pass scatters Y_b · pixel over the vertices.

    Args:
        layers: meshes.
        scene: gives the photographs.
        views: which of them.
        bases: (degree + 1)².
        ridge: for degree 0 and for degrees ≥ 1.

    Returns:
        per layer, [N, bases, 3] float32; a vertex that no view sees keeps its mean colour.
    """
    sums = [torch.zeros(len(mesh.vertices), bases, bases + 3) for mesh in layers]
    with progress_bar() as bar:
        for view in bar.track(views, description="fitting colours"):
            basis = harmonics(view.camera.rays(), bases).permute(2, 0, 1)
            colour = torch.from_numpy(scene.load_image(view)).permute(2, 0, 1) / 255
            mask = scene.load_mask(view)
            shown = torch.cat([basis, colour])
            if mask is not None:
                shown = shown * torch.from_numpy(mask)
            for total, mesh in zip(sums, layers, strict=True):
                _scatter(total, mesh, view, shown)
    return [_solve(total, mean, ridge) for total, mean in zip(sums, mean_colours(layers), strict=True)]


def _scatter(total: Tensor, mesh: Mesh, view: View, shown: Tensor) -> None:
    """Add Y_b · shown_c of every pixel to the vertices of its face."""
    camera, faces = view.camera, torch.from_numpy(mesh.faces)
    h = camera.project(torch.from_numpy(mesh.vertices))
    face, bary = rasterize_faces(h, faces, camera.height, camera.width)
    seen = face >= 0
    # Renumbered to the vertices in view, so that the sums cost what is seen.
    vertices, corners = torch.unique(faces[face[seen].long()], return_inverse=True)
    pixel = torch.full_like(face, -1)
    pixel[seen] = torch.arange(len(corners), dtype=torch.int32)
    zeros = torch.zeros(len(vertices), *total.shape[1:], requires_grad=True)
    image = shade_faces(pixel, bary, corners.int(), camera.rays(), zeros)
    (scattered,) = torch.autograd.grad(image, zeros, shown)
    total.index_add_(0, vertices, scattered)


def _solve(sums: Tensor, mean: Tensor, ridge: tuple[float, float]) -> Tensor:
    """Solve per vertex for the deviation from its mean colour, which is also what an unseen vertex keeps."""
    bases = sums.shape[1]
    normal, rhs = sums[..., :bases].double(), sums[..., bases:].double()
    mean = mean.double()
    weight = normal[:, 0, 0] / SH_CONSTANT**2
    diagonal = torch.tensor([ridge[0]] + [ridge[1]] * (bases - 1), dtype=torch.float64)
    regular = normal + torch.diag_embed(diagonal * (weight[:, None] + 1e-6))
    fitted: Tensor = torch.linalg.solve(regular, rhs - normal[..., :1] @ mean)
    fitted[:, :1] += mean
    return fitted.float()
