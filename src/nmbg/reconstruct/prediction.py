"""A photograph predicted from others over a geometry: how a geometry is judged before anything is trained."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from nmbg.blending import blend_into
from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.ops import rasterize_faces
from nmbg.reconstruct.gallery import Gallery

# Photographs blended in a pixel.
BLENDED = 5


def predict(
    gallery: Gallery, i: int, sources: Sequence[int], texels: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """Blend what other photographs show of the surface that a view sees, as the renderer blends them.

    Args:
        gallery: views with the depth of the geometry to be judged.
        i: the view to be predicted; h × w pixels.
        sources: the views that are blended.
        texels: mip chain (`mip_chain`) of every view's photograph, uint8.

    Returns:
        colour [h, w, 3] float32 of 255, and the score [h, w] float32 of the best source: 0 where none shows
        the point, and the colour is 0 too.
    """
    blend = blend_into(
        gallery.cameras[i],
        _seen(gallery, i),
        [gallery.cameras[j] for j in sources],
        [texels[j] for j in sources],
        [_seen(gallery, j) for j in sources],
        BLENDED,
    )
    return 255 * blend.colour.permute(1, 2, 0), blend.weight


def shade(mesh: Mesh, camera: Camera) -> tuple[Tensor, Tensor]:
    """The colours of a mesh as a camera sees them, [H, W, 3] float32 of 255, and where it sees it, [H, W]."""
    if not len(mesh.faces):
        image = torch.zeros(camera.height, camera.width, 3)
        return image, torch.zeros(image.shape[:2], dtype=torch.bool)
    faces = torch.from_numpy(mesh.faces)
    h = camera.project(torch.from_numpy(mesh.vertices))
    face, bary, _ = rasterize_faces(h, faces, camera.height, camera.width)
    corners = torch.from_numpy(mesh.colours)[faces[face.clamp(min=0).long()].long()]
    covered = face >= 0
    return (bary[..., None] * corners).sum(-2) * covered[..., None], covered


def _seen(gallery: Gallery, i: int) -> Tensor:
    """Depth [h, w] of what a view sees, 0 where it sees nothing or is masked out."""
    _, _, inside, depth = gallery.view(i)
    return torch.where(inside & depth.isfinite(), depth, 0.0)
