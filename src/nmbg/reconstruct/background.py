"""What stands behind a mesh: nothing, a far shell, or closed holes too; left-out photographs decide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nmbg.mesh import Mesh, empty_mesh, in_morton_order, merge
from nmbg.reconstruct.colours import mean_vertex_colours, spread
from nmbg.reconstruct.completion import close_holes
from nmbg.reconstruct.gallery import Gallery
from nmbg.reconstruct.judgement import left_out, score
from nmbg.reconstruct.shell import far_shell
from nmbg.sight import look

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
        return Background(empty_mesh(), paint(far_shell(gallery), gallery))
    patches = close_holes(gallery)
    shell = far_shell(gallery.before([look(patches, c) for c in gallery.cameras]))
    # The shell is painted as if there were no patches: it is seen where they end.
    return Background(paint(patches, gallery), paint(shell, gallery))


def paint(background: Mesh, gallery: Gallery) -> Mesh:
    """A surface in the mean colours of what photographs show where they see no mesh, carried on elsewhere."""
    if not len(background.faces):
        return background
    open_pixels = (
        (camera, gallery.view(i)[1].numpy(), gallery.open(i).numpy())
        for i, camera in enumerate(gallery.cameras)
    )
    colours = spread(*mean_vertex_colours(background, open_pixels), background.faces)
    return in_morton_order(replace(background, colours=colours.round().clip(0, 255).astype(np.uint8)))


def best_background(gallery: Gallery) -> tuple[str, str]:
    """Choose the kind of background that predicts left-out training views best; the kind, and why."""
    turns = left_out(gallery)
    if not turns:
        return "shell", f"{len(gallery)} training views are too few to judge closed holes"
    kinds = ("none", "shell", "closed")
    scores = []
    for judged in turns:
        rest = gallery.part([i for i in range(len(gallery)) if i not in judged])
        scores.append(score(gallery, judged, [make_background(kind, rest).whole for kind in kinds]))
    psnr = dict(zip(kinds, np.concatenate(scores).mean(0), strict=True))
    best = kinds[0]
    for kind in kinds[1:]:
        if psnr[kind] > psnr[best] + MARGIN:
            best = kind
    figures = ", ".join(f"{kind} {psnr[kind]:.2f}" for kind in kinds)
    n = sum(map(len, turns))
    return best, f"{n} training views left out in turns, predicted from the others (PSNR, dB): {figures}"
