"""A photograph predicted from others over a geometry: how a geometry is judged before anything is trained."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.reconstruct.depths import unproject
from nmbg.reconstruct.gallery import Gallery

# A photograph that sees a surface nearer than the point by more than this share of its depth shows another.
HIDDEN = 0.02
# Angle between two rays at which the weight of a photograph has fallen to 1/e, radians.
ANGLE = 0.05


def predict(camera: Camera, depth: Tensor, sources: Gallery) -> tuple[Tensor, Tensor]:
    """Blend what other photographs show of the surface that a camera sees.

    Args:
        camera: of the new view.
        depth: [H, W] view-space z of the surface, infinite where there is none.
        sources: photographs with the depth of the same geometry.

    Returns:
        colour [H, W, 3] float32 of 255, and known [H, W] bool: whether a source shows the point (else 0).
    """
    surface = depth.isfinite()
    image, known = torch.zeros(*depth.shape, 3), torch.zeros_like(surface)
    points = torch.from_numpy(unproject(camera, torch.where(surface, depth, 1.0)))[surface]
    found = sources.look_up(points)
    own = F.normalize(points - torch.from_numpy(camera.centre), dim=-1)
    centres = torch.from_numpy(np.stack([source.centre for source in sources.cameras]))
    theirs = F.normalize(points - centres[:, None], dim=-1)
    angle = (theirs * own).sum(-1).clamp(-1, 1).acos().float()
    # Nearest angles first, however large: far shells are seen under all of them.
    nearest = torch.where(found.visible(HIDDEN), angle, torch.inf).amin(0)
    weight = torch.where(found.visible(HIDDEN), torch.exp((nearest - angle) / ANGLE), 0.0)
    height, width = sources.depth.shape[1:]
    grid = (2 * found.uv / torch.tensor([width, height]) - 1).float()
    fetched = F.grid_sample(
        sources.images.permute(0, 3, 1, 2).float(), grid[:, None], padding_mode="border", align_corners=False
    )[:, :, 0].permute(0, 2, 1)
    total = weight.sum(0)
    image[surface] = (weight[..., None] * fetched).sum(0) / total.clamp(min=1e-12)[:, None]
    known[surface] = total > 0
    return image, known
