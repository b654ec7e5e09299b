"""Where descriptors start: what the photographs show at each vertex, in closed form."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.model.config import ModelConfig
from nmbg.model.descriptors import SH_CONSTANT
from nmbg.model.fragments import LevelFragments
from nmbg.model.renderer import Renderer
from nmbg.ops import shade_faces
from nmbg.progress import progress_bar
from nmbg.training.views import Views


def mean_colours(renderer: Renderer) -> list[Tensor]:
    """Degree-0 coefficients [N, 1, 3] per layer from the scene's mean vertex colours."""
    return [torch.from_numpy(mesh.colours).float()[:, None] / 255 / SH_CONSTANT for mesh in renderer.layers]


def fitted_colours(renderer: Renderer, views: Views, shrinkage: float = 0.02) -> list[Tensor]:
    """Least-squares harmonics of the colours that the views show at each vertex.

    Every pixel is an observation of its face's three vertices, weighted by the barycentrics; per vertex the
    normal equations (AᵀA + λ) c = Aᵀ colour are summed over the views and solved. The sums are gradients of
    shading: the scatter of Y_b · pixel over the vertices is what its backward pass computes.

    Args:
        renderer: gives the geometry and the degree.
        views: the training views.
        shrinkage: λ for degrees ≥ 1, relative to the weight of a vertex; where few directions were seen it
            keeps the fit near the mean colour.

    Returns:
        per layer, [N, (degree + 1)², 3] float32.
    """
    bases = renderer.config.bases
    sums = [torch.zeros(len(mesh.vertices), bases, bases + 3) for mesh in renderer.layers]
    with progress_bar() as bar:
        for i in bar.track(range(len(views)), description="fitting colours"):
            example = views.frame(i)
            for total, layer in zip(sums, example.fragments, strict=True):
                finest = layer.levels[0]
                if finest.face is None or finest.bary is None:
                    raise ValueError("colours are fitted through the faces; this model has none")
                rays = finest.camera.resized(*finest.face.shape[::-1]).rays()
                mask = (
                    torch.ones_like(example.image[0], dtype=torch.bool)
                    if example.mask is None
                    else example.mask
                )
                seen = _on_samples(mask[None].float(), finest)
                colour = _on_samples(example.image / 255, finest) * seen
                basis = harmonics(rays, renderer.config) * seen
                zeros = torch.zeros(len(layer.vertices), bases, bases + 3, requires_grad=True)
                shown = shade_faces(finest.face, finest.bary, layer.faces, rays, zeros)
                (scattered,) = torch.autograd.grad(shown, zeros, torch.cat([basis, colour]))
                total[layer.vertices] += scattered
    return [_solve(total, mean, shrinkage) for total, mean in zip(sums, mean_colours(renderer), strict=True)]


def harmonics(rays: Tensor, config: ModelConfig) -> Tensor:
    """Spherical harmonics of unit directions [H, W, 3] as an image, [(degree + 1)², H, W]."""
    height, width, _ = rays.shape
    identity = torch.eye(config.bases)[None].expand(3, -1, -1).contiguous()
    corner = torch.zeros(height, width, 3)
    corner[..., 0] = 1
    return shade_faces(
        torch.zeros(height, width, dtype=torch.int32),
        corner,
        torch.tensor([[0, 1, 2]], dtype=torch.int32),
        rays,
        identity,
    )


def _on_samples(image: Tensor, level: LevelFragments) -> Tensor:
    """An image [C, H, W] on a level's samples: zero-padded, each pixel repeated for its s × s samples."""
    assert level.face is not None
    s = level.face.shape[0] // level.camera.height
    padding = (0, level.camera.width - image.shape[2], 0, level.camera.height - image.shape[1])
    return F.pad(image, padding).repeat_interleave(s, 1).repeat_interleave(s, 2)


def _solve(sums: Tensor, mean: Tensor, shrinkage: float) -> Tensor:
    """Solve per vertex for the deviation from its mean colour, which is also what an unseen vertex keeps."""
    bases = sums.shape[1]
    normal, rhs = sums[..., :bases].double(), sums[..., bases:].double()
    mean = mean.double()
    weight = normal[:, 0, 0] / SH_CONSTANT**2
    ridge = torch.full((bases,), shrinkage, dtype=torch.float64)
    ridge[0] = 1e-4
    normal_reg = normal + torch.diag_embed(ridge[None] * (weight[:, None] + 1e-6))
    residual = rhs - normal[..., :1] @ mean
    fitted = torch.linalg.solve(normal_reg, residual)
    fitted[:, :1] += mean
    return fitted.float()
