"""Patches over the holes of a mesh, from the depths that the training views have around the holes.

In every training view the depth of pixels without a surface is filled from around, far sides first (what
shows through a hole lies behind), and a coarse grid of it becomes a patch. What another view contradicts is
left out: where it sees a surface behind the patch, or where it shows other colours. The views take turns,
those with the largest holes first, and each fills only what mesh and earlier patches leave open, so that
patches lie beside each other and not in a stack.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import GREY, Mesh, drop_unused, empty_mesh, merge
from nmbg.reconstruct.coverage import look
from nmbg.reconstruct.depths import FAR_EXPONENT, Floats, push_pull, unproject
from nmbg.reconstruct.gallery import Gallery

# Side of a patch's cells, pixels of the gallery: holes are smooth, or nothing is known about them.
CELL = 3
# Rounds of 3 × 3 means over the filled cells.
SMOOTHING = 3
# Neighbouring nodes of a patch whose depths differ by more than this factor are not joined.
JUMP = 1.3
# A patch contradicts a view when it stands in front of what the view sees by more than this share of depth.
IN_FRONT = 0.05
# A view that sees a surface nearer than the patch by more than this share of its depth cannot judge colours.
HIDDEN = 0.02
# Photographs agree while their colours (means over a cell, of 255) differ by less than this.
SAME_COLOUR = 25
# Share of the views that see a node of a patch which must agree about its colour.
AGREEING = 0.5
# The patch passes behind the surface that it joins by this share of the depth.
BEHIND = 0.003


def close_holes(gallery: Gallery) -> Mesh:
    """Patches over what the views of a gallery see no surface in; its vertices are grey.

    Args:
        gallery: the training views with the depth of the mesh.

    Returns:
        the patches alone; possibly without any vertex.
    """
    patches = empty_mesh()
    blurred = _blurred(gallery)
    for i in _largest_first(gallery):
        camera, _, inside, depth = gallery.view(i)
        if len(patches.faces):
            sight = look(patches, camera)
            depth = torch.minimum(depth, torch.where(sight.covered, sight.depth, torch.inf))
        open_ = inside & depth.isinf()
        if open_.any() and depth.isfinite().any():
            patches = merge(patches, _undisputed(_patch(camera, depth, open_), i, blurred))
    return patches


def _largest_first(gallery: Gallery) -> list[int]:
    holes = [int(gallery.open(i).sum()) for i in range(len(gallery))]
    return sorted((i for i, n in enumerate(holes) if n), key=lambda i: -holes[i])


def _blurred(gallery: Gallery) -> Gallery:
    """The gallery with images averaged over cells, so that a shift by a pixel is no other colour."""
    images = F.avg_pool2d(
        gallery.images.permute(0, 3, 1, 2).float(), CELL, 1, CELL // 2, count_include_pad=False
    )
    return Gallery(gallery.cameras, images.permute(0, 2, 3, 1).round().byte(), gallery.inside, gallery.depth)


def _patch(camera: Camera, depth: Tensor, open_: Tensor) -> Mesh:
    """A grid over the open pixels and the cells around them, which reach behind what is seen there.

    Args:
        camera: of the view.
        depth: [H, W] view-space z, infinite where no surface is seen, somewhere finite.
        open_: [H, W] bool, pixels to be covered.
    """
    # One cell more than the image on every side: the patch covers it to the border.
    right, below = -depth.shape[1] % CELL + CELL, -depth.shape[0] % CELL + CELL
    around = (CELL, right, CELL, below)
    known = F.pad(depth.isfinite(), around)[None, None].double()
    z = F.pad(torch.where(depth.isfinite(), depth, 0.0), around)[None, None].double()
    needed = F.pad(open_[None, None].double(), around, mode="replicate")

    share = F.avg_pool2d(known, CELL)
    largest = z.max()
    power = F.avg_pool2d((z / largest) ** FAR_EXPONENT, CELL) / share.clamp(min=1e-12)
    power = push_pull(power, (share > 0).double())
    for _ in range(SMOOTHING):
        power = F.avg_pool2d(F.pad(power, (1, 1, 1, 1), mode="replicate"), 3, 1)
    node = (power ** (1 / FAR_EXPONENT) * largest).maximum((1 + BEHIND) * F.max_pool2d(z, CELL))[0, 0]

    wider = camera.cropped(-CELL, -CELL, camera.width + CELL + right, camera.height + CELL + below)
    rows, columns = node.shape
    vertices = unproject(wider.resized(columns, rows), node).reshape(-1, 3)
    return _grid(vertices, node, F.max_pool2d(needed, CELL)[0, 0] > 0)


def _grid(vertices: Floats, node: Tensor, needed: Tensor) -> Mesh:
    """Triangles between neighbouring nodes [R, C] where one is needed and no depth jumps."""
    corner = torch.arange(node.numel()).reshape(node.shape)
    a, b, c, d = (x.flatten() for x in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    faces = torch.cat([torch.stack([a, c, b], 1), torch.stack([b, c, d], 1)])
    z = node.flatten()[faces]
    quad = F.max_pool2d(needed[None, None].float(), 2, 1)[0, 0].flatten() > 0
    keep = quad.repeat(2) & (z.amax(1) < JUMP * z.amin(1))
    mesh = Mesh(
        vertices.astype(np.float32),
        faces.numpy().astype(np.int32),
        np.full(vertices.shape, GREY, dtype=np.uint8),
    )
    return drop_unused(mesh, keep.numpy())


def _undisputed(patch: Mesh, own: int, gallery: Gallery) -> Mesh:
    """The patch of one view without the vertices that other views contradict."""
    found = gallery.look_up(torch.from_numpy(patch.vertices))
    others = torch.arange(len(gallery)) != own
    in_front = found.inside & (found.z < (1 - IN_FRONT) * found.surface) & found.surface.isfinite()
    judges = found.visible(HIDDEN) & others[:, None]
    colours = gallery.colours(found).float()
    agree = (colours - colours[own]).abs().mean(-1) < SAME_COLOUR
    votes, agreeing = judges.sum(0), (judges & agree).sum(0)
    keep = ~in_front[others].any(0) & (agreeing >= AGREEING * votes)
    return drop_unused(patch, keep[torch.from_numpy(patch.faces).long()].all(1).numpy())
