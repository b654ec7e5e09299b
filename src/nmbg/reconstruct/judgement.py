"""How well a background serves: training photographs are left out and predicted from the others over it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nmbg.mesh import Mesh
from nmbg.ops import mip_chain
from nmbg.reconstruct.gallery import Gallery
from nmbg.reconstruct.prediction import predict, shade
from nmbg.scene import evenly
from nmbg.sight import look

# So many views are judged at most.
JUDGED = 12
# They are left out in turns, at most this share of the views at a time: fewer views close worse.
LEFT_OUT = 0.1
# Each is predicted from so many others, those that look most alike.
SOURCES = 16


def left_out(gallery: Gallery) -> list[list[int]]:
    """Which views judge, in turns that leave out few at a time; none of fewer than three.

    They are spread over that half of the views that see most pixels without surface: the others tell nothing.
    """
    n_views = len(gallery)
    if n_views < 3:
        return []
    holes = [int(gallery.open(i).sum()) for i in range(n_views)]
    telling = sorted(sorted(range(n_views), key=lambda i: -holes[i])[: -(-n_views // 2)])
    judged = evenly(telling, JUDGED)
    turns = -(-len(judged) // max(1, int(LEFT_OUT * n_views)))
    return [judged[turn::turns] for turn in range(turns)]


def score(gallery: Gallery, judged: Sequence[int], backgrounds: Sequence[Mesh]) -> npt.NDArray[np.float64]:
    """How well photographs are predicted from others over each of several geometries.

    Args:
        gallery: the training views, with the depth of the mesh.
        judged: the V views to be predicted, from views that are not among them.
        backgrounds: what stands behind the mesh, coloured; nothing of it made from the judged views.

    Returns:
        PSNR of each view inside its mask over each background, [V, len(backgrounds)] dB. Where no photograph
        shows what a view sees, the background counts in its own colours, and the mesh in the mean colour of
        what is seen without surface.
    """
    sources = [_sources(gallery, i, judged) for i in judged]
    needed = sorted({*judged, *(j for some in sources for j in some)})
    place = {i: k for k, i in enumerate(needed)}
    bare = gallery.part(needed)
    texels = [mip_chain(*bare.view(k)[1:3]) for k in range(len(bare))]
    mean = _mean_without_surface(bare.part([place[i] for i in needed if i not in judged]))
    psnr = np.zeros((len(judged), len(backgrounds)))
    for column, background in enumerate(backgrounds):
        hung = bare.before([look(background, camera) for camera in bare.cameras])
        for row, i in enumerate(judged):
            camera, truth, inside, depth = hung.view(place[i])
            image, known = predict(hung, place[i], [place[j] for j in sources[row]], texels)
            behind = depth < bare.view(place[i])[3]
            unknown = torch.where(behind[..., None], shade(background, camera)[0], mean)
            image = torch.where(known[..., None] > 0, image, unknown)
            error = (image - truth.float())[inside].square().mean().item()
            psnr[row, column] = -10 * np.log10(max(error, 1e-6) / 255**2)
    return psnr


def _sources(gallery: Gallery, i: int, judged: Sequence[int]) -> list[int]:
    alike = gallery.most_alike(i, SOURCES + len(judged))
    return [j for j in alike if j not in judged][:SOURCES]


def _mean_without_surface(gallery: Gallery) -> Tensor:
    """Mean colour [3] of the pixels that count but see no surface, or of all where there are none."""
    open_ = gallery.inside & gallery.depth.isinf()
    chosen = open_ if open_.any() else gallery.inside
    return gallery.images[chosen].float().mean(0)
