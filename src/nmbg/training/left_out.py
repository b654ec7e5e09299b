"""Training views as the other photographs show them: what a network learns from, and is judged on."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import partial

from nmbg.cameras import Camera
from nmbg.model.photographs import Gathered
from nmbg.model.renderer import Renderer, coloured
from nmbg.scene import Scene, View
from nmbg.training.config import TrainConfig
from nmbg.training.start import ColourFit

# More folds leave more of the views in each fit; every fold has residuals of all photographs.
FOLDS = 4


def can_leave_out(config: TrainConfig) -> bool:
    """Whether what a model shows of a view can be had without its photograph: no step moves its colours."""
    moved = any(stage.descriptor_rate > 0 for stage in config.stages)
    return config.model.sources > 0 and config.start == "fit" and not moved


def fit_left_out(renderer: Renderer, scene: Scene) -> ColourFit:
    """Colours of a scene's training views on a renderer's geometry, in folds."""
    folds = min(FOLDS, len(scene.train))
    return ColourFit(renderer.layers, scene, scene.train, renderer.config.bases, folds)


class LeftOut:
    """Training views without their own photograph, which is neither blended nor in the colours on the mesh.

    The colours, and with them the residuals of all photographs, are fitted once per fold of views, without
    it; a view is seen over those of its fold. What the network sees then errs as it will on new views.

    Args:
        renderer: gives geometry, photographs, and by its colours the degree of each vertex.
        fit: colours of the training views in folds.
    """

    def __init__(self, renderer: Renderer, fit: ColourFit) -> None:
        assert renderer.photographs is not None
        # A resumed run knows degrees by the colours alone, and vertices round by which are solved together.
        self.fit = copy(fit)
        self.fit.degrees = renderer.degrees()
        self.meshes = [
            Renderer(replace(renderer.config, widths=()), renderer.layers) for _ in range(fit.folds)
        ]
        for fold, mesh in enumerate(self.meshes):
            mesh.set_colours(self.fit.coefficients(without=fold))
        self.photographs = renderer.photographs.recoloured(partial(coloured, self.meshes))

    @property
    def nbytes(self) -> int:
        """Memory held by prepared photographs, bytes."""
        return self.photographs.nbytes

    def see(self, camera: Camera, view: View) -> Gathered:
        """What mesh and other photographs show of a training view."""
        fold = self.fit.fold_of(view)
        return self.photographs.gather(camera, *self.meshes[fold].on_mesh(camera), {view.name}, fold)
