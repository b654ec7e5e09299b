"""Patches over the holes of a mesh, from the depths that the training views have around the holes.

In every training view the depth of pixels without a surface is filled from around, far sides first (what
shows through a hole lies behind); a coarse grid of it is moved along the rays to where the photographs agree
best, and becomes a patch. Left out is what stands in front of a surface that another view sees, and what
turns its back to a camera close by. The views take turns, those with the largest holes first, and each fills
only what mesh and earlier patches leave open, so that patches lie beside each other and not in a stack.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import GREY, Mesh, drop_unused, empty_mesh, merge
from nmbg.reconstruct.depths import FAR_EXPONENT, push_pull, unproject
from nmbg.reconstruct.gallery import Gallery
from nmbg.sight import look

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
# Photographs barely agree where their colours (means over a cell, of 255) differ by this.
SAME_COLOUR = 25
# Depths that are tried, as factors of the filled one, from nearer to further: 17 steps of a tenth.
SWEEP = tuple(math.exp(0.1 * step) for step in range(-4, 13))
# What a step costs, against differences of colours (of 255) per factor e; 30 does as well within 0.05 dB.
DISTANCE_COST = 10.0
# Nodes are moved by the mean verdict on so many by so many.
SWEEP_WINDOW = 5
# So many photographs judge, those that look most alike.
SWEEP_VIEWS = 24
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
            grid, node, seen, needed = _fill(camera, depth, open_)
            node = _swept(grid, node, seen, needed, i, blurred)
            patches = merge(patches, _undisputed(_patch(grid, node, needed), i, blurred))
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


def _fill(camera: Camera, depth: Tensor, open_: Tensor) -> tuple[Camera, Tensor, Tensor, Tensor]:
    """Depth at the nodes of a grid over a view, which reaches behind what is seen beside the open pixels.

    Args:
        camera: of the view.
        depth: [H, W] view-space z, infinite where no surface is seen, somewhere finite.
        open_: [H, W] bool, pixels to be covered.

    Returns:
        a camera with one pixel per node; the nodes' depth [R, C] float64; the largest depth that is seen in
        each node's cell, 0 where none is; and whether the cell has open pixels, [R, C] bool.
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
    seen = (1 + BEHIND) * F.max_pool2d(z, CELL)[0, 0]
    node = (power ** (1 / FAR_EXPONENT) * largest)[0, 0].maximum(seen)
    wider = camera.cropped(-CELL, -CELL, camera.width + CELL + right, camera.height + CELL + below)
    rows, columns = node.shape
    return wider.resized(columns, rows), node, seen, F.max_pool2d(needed, CELL)[0, 0] > 0


def _swept(grid: Camera, node: Tensor, seen: Tensor, needed: Tensor, own: int, gallery: Gallery) -> Tensor:
    """The nodes [R, C] moved along their rays to where the most alike photographs agree about the colours.

    They move together, as the mean over a few nodes tells, and only where it gains more than the distance
    from the filled depth costs.
    """
    moved = _window_max(needed.double(), 3)  # those around it belong to the patch too
    free = moved > 0
    alike = gallery.part([own, *gallery.most_alike(own, SWEEP_VIEWS)])
    factors = torch.tensor(SWEEP, dtype=torch.float64)
    centre = torch.from_numpy(grid.centre)
    offset = torch.from_numpy(unproject(grid, node))[free] - centre
    points = centre + factors[:, None, None] * offset
    judges, difference, in_front = _judge(points.flatten(0, 1), 0, alike)
    # One vote of doubt: what nobody sees costs what photographs cost that barely agree.
    cost = ((difference.clamp(max=2 * SAME_COLOUR) * judges).sum(0) + SAME_COLOUR) / (judges.sum(0) + 1)
    cost[in_front] = 2 * SAME_COLOUR
    volume = node.new_zeros(len(factors), *node.shape)
    volume[:, free] = cost.double().reshape(len(factors), -1) + DISTANCE_COST * factors.log().abs()[:, None]
    log = factors.log()[_window_mean(volume, moved, SWEEP_WINDOW).argmin(0)]
    for _ in range(SMOOTHING - 1):
        log = _window_mean((log * moved)[None], moved, 3)[0]
    return (node * log.exp()).maximum(seen)


def _window_max(image: Tensor, side: int) -> Tensor:
    """Largest value around each pixel of an image [R, C]."""
    return F.max_pool2d(image[None], side, 1, side // 2)[0]


def _window_mean(images: Tensor, weight: Tensor, side: int) -> Tensor:
    """Means around each pixel of images [N, R, C], which are 0 where the weight [R, C] of 0 or 1 is."""
    total = F.avg_pool2d(weight[None], side, 1, side // 2)
    return F.avg_pool2d(images, side, 1, side // 2) / total.clamp(min=1e-6)


def _patch(grid: Camera, node: Tensor, needed: Tensor) -> Mesh:
    """Triangles between neighbouring nodes [R, C] where one is needed and no depth jumps."""
    corner = torch.arange(node.numel()).reshape(node.shape)
    a, b, c, d = (x.flatten() for x in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    faces = torch.cat([torch.stack([a, c, b], 1), torch.stack([b, c, d], 1)])
    z = node.flatten()[faces]
    quad = F.max_pool2d(needed[None, None].float(), 2, 1)[0, 0].flatten() > 0
    keep = quad.repeat(2) & (z.amax(1) < JUMP * z.amin(1))
    vertices = unproject(grid, node).reshape(-1, 3).astype(np.float32)
    grey = np.full(vertices.shape, GREY, dtype=np.uint8)
    return drop_unused(Mesh(vertices, faces.numpy().astype(np.int32), grey), keep.numpy())


def _undisputed(patch: Mesh, own: int, gallery: Gallery) -> Mesh:
    """The patch of one view without the vertices that other views contradict."""
    points = torch.from_numpy(patch.vertices)
    _, _, in_front = _judge(points, own, gallery)
    keep = ~in_front & ~_turned_away(points, own, gallery)
    return drop_unused(patch, keep[torch.from_numpy(patch.faces).long()].all(1).numpy())


def _turned_away(points: Tensor, own: int, gallery: Gallery) -> Tensor:
    """Whether points [N, 3] of one view's patch turn their back to a camera that is nearer than the own one.

    Only a camera that does not look at them counts. It contradicts nothing, but a camera beside it that does
    look would see the back of a patch and nothing else.
    """
    centres = torch.from_numpy(np.stack([camera.centre for camera in gallery.cameras])).float()
    to_camera = centres[:, None] - points
    distance = to_camera.norm(dim=-1)
    behind = (to_camera * to_camera[own]).sum(-1) < 0
    unseen = ~gallery.look_up(points).inside
    turned: Tensor = (behind & unseen & (distance < distance[own])).any(0)
    return turned


def _judge(points: Tensor, own: int, gallery: Gallery) -> tuple[Tensor, Tensor, Tensor]:
    """What other views say about points [N, 3] that lie in front of one view's photograph.

    Returns:
        whether each other view would see the point, [V, N] bool; how much its colour differs from the own
        view's, [V, N] of 255; whether the point stands in front of what any other view sees, [N] bool.
    """
    found = gallery.look_up(points)
    others = (torch.arange(len(gallery)) != own)[:, None]
    in_front = found.inside & (found.z < (1 - IN_FRONT) * found.surface) & found.surface.isfinite()
    colours = gallery.colours(found).float()
    difference = (colours - colours[own]).abs().mean(-1)
    return found.visible(HIDDEN) & others, difference, (in_front & others).any(0)
