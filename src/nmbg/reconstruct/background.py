"""What stands behind a mesh: nothing, a far shell, or closed holes too; left-out photographs decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from nmbg.mesh import Mesh, empty_mesh, merge
from nmbg.ops import mip_chain
from nmbg.reconstruct.completion import close_holes
from nmbg.reconstruct.gallery import Gallery
from nmbg.reconstruct.prediction import predict
from nmbg.reconstruct.shell import far_shell
from nmbg.sight import look

# So many views are left out and judged, spread over the capture, and at most one of three.
JUDGED = 8
# Each is predicted from so many others, those that look most alike.
SOURCES = 16
# More geometry must gain at least this much over less, dB: below it the judged views may differ by chance.
MARGIN = 0.05


@dataclass(frozen=True, eq=False)
class Background:
    """What stands behind a mesh.

    Args:
        patches: over its holes; empty unless they were closed.
        shell: behind everything; empty when there is no background.
    """

    patches: Mesh
    shell: Mesh

    @property
    def whole(self) -> Mesh:
        """Patches, then shell."""
        return merge(self.patches, self.shell)


def make_background(kind: str, gallery: Gallery) -> Background:
    """Make a background of a kind ("none", "shell" or "closed") from training views with the mesh's depth."""
    if kind == "none":
        return Background(empty_mesh(), empty_mesh())
    if kind == "shell":
        return Background(empty_mesh(), far_shell(gallery))
    patches = close_holes(gallery)
    return Background(patches, far_shell(gallery.before([look(patches, c) for c in gallery.cameras])))


def best_background(gallery: Gallery) -> tuple[str, str]:
    """Choose the kind of background that predicts left-out training views best; the kind, and why."""
    judged = left_out(len(gallery))
    if not judged:
        return "shell", f"{len(gallery)} training views are too few to judge closed holes"
    rest = gallery.part([i for i in range(len(gallery)) if i not in judged])
    kinds = ("none", "shell", "closed")
    psnr = score(gallery, judged, {kind: make_background(kind, rest).whole for kind in kinds})
    best = kinds[0]
    for kind in kinds[1:]:
        if psnr[kind] > psnr[best] + MARGIN:
            best = kind
    figures = ", ".join(f"{kind} {psnr[kind]:.2f}" for kind in kinds)
    return best, f"{len(judged)} training views left out, predicted from the others (PSNR, dB): {figures}"


def left_out(n_views: int) -> list[int]:
    """Which of n views judge: spread evenly; none of fewer than three."""
    n = min(JUDGED, n_views // 3)
    return [int((i + 0.5) * n_views / n) for i in range(n)]


def score(gallery: Gallery, judged: Sequence[int], backgrounds: Mapping[str, Mesh]) -> dict[str, float]:
    """How well photographs are predicted from the others over each of several geometries.

    Args:
        gallery: the training views, with the depth of the mesh.
        judged: the views to be predicted.
        backgrounds: what stands behind the mesh; nothing of it may have been made from the judged views.

    Returns:
        the mean PSNR over the judged views inside their masks, dB; pixels about which no photograph says
        anything count with the mean colour of what other views show where they see no mesh.
    """
    sources = {i: gallery.most_alike(i, SOURCES) for i in judged}
    needed = sorted({*judged, *(j for some in sources.values() for j in some)})
    place = {i: k for k, i in enumerate(needed)}
    bare = gallery.part(needed)
    texels = [mip_chain(bare.view(k)[1], bare.view(k)[2]) for k in range(len(bare))]
    out = {}
    for name, background in backgrounds.items():
        hung = bare.before([look(background, c) for c in bare.cameras])
        psnr = []
        for i in judged:
            _, truth, inside, _ = hung.view(place[i])
            others = [place[j] for j in sources[i]]
            image, known = predict(hung, place[i], others, texels)
            image[known == 0] = _mean_without_surface(bare.part(others))
            error = (image - truth.float())[inside].square().mean()
            psnr.append(-10 * np.log10(max(error.item(), 1e-6) / 255**2))
        out[name] = float(np.mean(psnr))
    return out


def _mean_without_surface(gallery: Gallery) -> Tensor:
    """Mean colour [3] of the pixels that count but see no surface, or of all where there are none."""
    open_ = gallery.inside & gallery.depth.isinf()
    chosen = open_ if open_.any() else gallery.inside
    return gallery.images[chosen].float().mean(0)
