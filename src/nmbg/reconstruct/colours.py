"""Mean colours that the photographs show at the vertices of a mesh."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import torch

from nmbg.cameras import Camera
from nmbg.images import Image, Mask
from nmbg.mesh import Mesh
from nmbg.ops import rasterize_faces

# Weight below which a vertex counts as unseen: a thousandth of a pixel.
LEAST_WEIGHT = 1e-3


def mean_vertex_colours(
    mesh: Mesh, photographs: Iterable[tuple[Camera, Image, Mask | None]]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Average what the photographs show at each vertex, where the vertex's faces are the nearest.

    Each pixel is shared among the vertices of its face by the barycentrics.

    Args:
        mesh: the surface.
        photographs: cameras with their photographs [H, W, 3] uint8 and masks [H, W] bool, read one at a time.

    Returns:
        colours [N, 3] float32 in [0, 255] (0 where unseen) and whether each vertex was seen, [N] bool.
    """
    vertices, faces = torch.from_numpy(mesh.vertices), torch.from_numpy(mesh.faces)
    sums = torch.zeros(len(vertices), 4)
    for camera, photograph, mask in photographs:
        face, bary, _ = rasterize_faces(camera.project(vertices), faces, camera.height, camera.width)
        image = torch.from_numpy(photograph).float()
        shown = torch.cat([image, torch.ones_like(image[..., :1])], dim=2)
        counts = face >= 0 if mask is None else (face >= 0) & torch.from_numpy(mask)
        corners = faces[face[counts].long()].long()
        sums.index_add_(
            0, corners.flatten(), (bary[counts][..., None] * shown[counts][:, None]).flatten(0, 1)
        )
    seen = sums[:, 3] > LEAST_WEIGHT
    colours = torch.where(seen[:, None], sums[:, :3] / sums[:, 3:].clamp(min=LEAST_WEIGHT), 0.0)
    return colours.numpy(), seen.numpy()


def spread(
    values: npt.NDArray[np.float32], known: npt.NDArray[np.bool_], faces: npt.NDArray[np.int32]
) -> npt.NDArray[np.float32]:
    """Carry values from known vertices along edges to the unknown; what no edge reaches takes the mean.

    Args:
        values: [N, C].
        known: [N] bool.
        faces: [M, 3] int32.

    Returns:
        [N, C], unchanged where known.
    """
    values, known = values.copy(), known.copy()
    if not known.any():
        return values
    mean = values[known].mean(0)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = edges[~known[edges[:, 1]]]
    while len(edges):
        into = edges[known[edges[:, 0]]]
        if not len(into):
            break
        targets, slots = np.unique(into[:, 1], return_inverse=True)
        sums = np.zeros((len(targets), values.shape[1]))
        np.add.at(sums, slots, values[into[:, 0]])
        values[targets] = sums / np.bincount(slots)[:, None]
        known[targets] = True
        edges = edges[~known[edges[:, 1]]]
    values[~known] = mean
    return values
