"""A scene and a configuration → no more of both than the scene needs, choice by choice.

The network is trained with few channels, and sized when it is (`nmbg.capacity.network`).
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from torch import Tensor

from nmbg.capacity.choices import Choice, least, megabytes
from nmbg.capacity.harmonics import STEPS, USUAL_STEP, degrees_for, floats
from nmbg.capacity.judge import JUDGES, LIMIT, SOURCES_LIMIT, Judge, Score
from nmbg.capacity.network import few_channels
from nmbg.capacity.photographs import COST, blending, choose_photographs
from nmbg.capacity.storage import STORAGE_LIMIT, STORAGES, SUFFIX, USUAL, Storage, store, stored_bytes
from nmbg.capacity.thinning import OPENED, THINNING_LIMIT, halved, opened
from nmbg.capacity.vertices import drop_unseen
from nmbg.errors import NmbgError
from nmbg.images import can_write
from nmbg.mesh import Mesh
from nmbg.model.config import ModelConfig
from nmbg.model.cover import SourceCover
from nmbg.model.renderer import Renderer
from nmbg.progress import console
from nmbg.scene import Scene, View, evenly
from nmbg.training.config import TrainConfig
from nmbg.training.left_out import FOLDS, can_leave_out, fit_left_out
from nmbg.training.start import ColourFit, mean_colours


@dataclass(frozen=True)
class Plan:
    """What a run holds.

    Args:
        scene: with its geometry.
        config: with the model's size and the table of choices.
        photographs: that are kept.
        storage: how they are kept.
        fit: colours in closed form, where they are at hand.
    """

    scene: Scene
    config: TrainConfig
    photographs: tuple[View, ...]
    storage: Storage = STORAGES[-1]
    fit: ColourFit | None = None


def plan(scene: Scene, config: TrainConfig) -> Plan:
    """Decide what a run holds.

    Raises:
        NmbgError: `capacity` is "auto" for a preset that is not sized so.
    """
    if config.capacity == "full":
        kept = choose_photographs(scene, config.photos, config.model) if config.model.sources else ()
        return Plan(scene, config, kept)
    if not can_leave_out(config):
        raise NmbgError(
            f"--capacity auto: preset {config.preset} does not predict left-out views from photographs; "
            "use it with nmbg or photos"
        )
    return _Sizing(scene, config).plan()


class _Sizing:
    """Sizes one part after another; what was decided stands for those that follow."""

    def __init__(self, scene: Scene, config: TrainConfig) -> None:
        self.scene, self.config = scene, config
        self.choices = list(config.choices)
        # All in the first fold of the colours' fit, which is then fitted without them.
        self.judge = Judge(scene, evenly(scene.train[::FOLDS], JUDGES))
        self._cover: tuple[Mesh, SourceCover] | None = None

    def plan(self) -> Plan:
        """Decide everything."""
        self._vertices()
        kept = self._photographs()
        score = self._thinning(kept, self._sources(kept))
        storage = self._storage(kept)
        self._samples(kept, score)
        fit = self._harmonics(kept)
        config = few_channels(replace(self.config, choices=tuple(self.choices)))
        return Plan(self.scene, config, kept, storage, fit)

    def _chose(self, choice: str, saves: str, costs: str, reason: str) -> None:
        self.choices.append(Choice(choice, saves, costs, reason))
        console.print(str(self.choices[-1]), highlight=False)

    def _vertices(self) -> None:
        scene = self.scene
        self.scene = drop_unseen(scene)
        before, after = len(scene.mesh.vertices), len(self.scene.mesh.vertices)
        self._chose(
            f"vertices: {after} of {before}",
            f"{1 - after / before:.0%} of them",
            "nothing that these views see",
            "no training view sees the others, nor any view halfway between two",
        )
        shell = self.scene.shell_faces
        kept = f"behind it a far shell of {shell} faces stays" if shell else "there is no far shell"
        self._chose(
            "layers: 1", "the second one", "nothing", f"photographs are blended over one layer; {kept}"
        )

    def _photographs(self) -> tuple[View, ...]:
        wish = "auto" if self.config.photos == "all" else self.config.photos
        kept, n = choose_photographs(self.scene, wish, self.config.model), len(self.scene.train)
        costs = "nothing"
        if len(kept) < n:
            costs = f"{COST.psnr:g} dB of a view at most" if wish == "auto" else "unknown"
        why = "a view beside the next one needs it" if len(kept) > 1 else "one is the least there is"
        why = why if wish == "auto" else "wished for"
        self._chose(f"photographs: {len(kept)} of {n}", f"{n - len(kept)} files", costs, why)
        return kept

    def _sources(self, kept: tuple[View, ...]) -> Score:
        """The fewest photographs blended in a pixel that cost no more than the limit; what they score."""
        most = fewest = self.config.model.sources
        renderer = self._with_photographs(self.scene, kept)
        photographs = renderer.photographs
        assert photographs is not None
        best = score = self._score(renderer)
        why = "one is the least there is"
        for count in range(most - 1, 0, -1):
            photographs.sources = count
            found = self._score(renderer)
            if not found.within(best, SOURCES_LIMIT):
                why = f"{count} cost {found.cost_beside(best)}"
                break
            fewest, score = count, found
        saved = f"{most - fewest} of {most} looked up" if fewest < most else "nothing"
        self._chose(f"photographs in a pixel: {fewest}", saved, score.cost_beside(best), why)
        self._model(sources=fewest)
        return score

    def _thinning(self, kept: tuple[View, ...], best: Score) -> Score:
        """Half of the faces, and half of these, as long as it costs no more than the limit; what is left."""
        before, score = len(self.scene.mesh.faces), best
        whole = self.scene
        while True:
            fewer = halved(self.scene)
            if len(fewer.mesh.faces) == len(self.scene.mesh.faces):
                why = "no edge can go"
                break
            found = self._score(self._with_photographs(fewer, kept))
            if not found.within(best, THINNING_LIMIT):
                why = f"half of them costs {found.cost_beside(best)}"
                break
            hole = opened(whole, fewer, self.judge.views)
            if hole > OPENED:
                why = f"half of them opens {hole:.2%} of a view"
                break
            self.scene, score = fewer, found
        after = len(self.scene.mesh.faces)
        saved = f"{1 - after / before:.0%} of them" if after < before else "nothing"
        self._chose(f"faces: {after} of {before}", saved, score.cost_beside(best), why)
        return score

    def _storage(self, kept: tuple[View, ...]) -> Storage:
        """The least storage that costs no more than the limit, or that meets the wish for megabytes."""
        if not can_write(SUFFIX):
            self._chose(
                f"photographs: {STORAGES[-1]}", "nothing", "nothing", "OpenImageIO has no JPEG XL here"
            )
            return STORAGES[-1]
        with tempfile.TemporaryDirectory() as folder:

            @cache
            def stored(i: int) -> tuple[Score, int]:
                place = Path(folder) / str(i)
                views = store(self.scene, kept, place, STORAGES[i])
                renderer = self._with_photographs(replace(self.scene, folder=place), views)
                return self._score(renderer), stored_bytes(place)

            last = len(STORAGES) - 1
            best, full = stored(last)
            limit = 1e6 * (self.config.megabytes or math.inf)

            def fits(i: int) -> bool:
                return stored(i)[0].within(best, STORAGE_LIMIT)

            i = least(fits, USUAL)
            while i > 0 and stored(i)[1] > limit:
                i -= 1
            if stored(i)[1] >= full:
                i = last
            score, size = stored(i)
            if not fits(i):
                why = f"wished for at most {megabytes(limit)}"
            elif i == last:
                why = "what is good enough takes no fewer bytes"
            elif i > 0:
                why = f"{STORAGES[i - 1]} costs {stored(i - 1)[0].cost_beside(best)}"
            else:
                why = "the least there is"
        saved = f"{megabytes(full - size)} of {megabytes(full)}"
        self._chose(f"photographs: {STORAGES[i]}", saved, score.cost_beside(best), why)
        return STORAGES[i]

    def _samples(self, kept: tuple[View, ...], one: Score) -> None:
        """One sample a pixel, which scores `one`, where more show nothing."""
        samples = self.config.model.supersample
        if samples == 1:
            return
        best = self._score(self._with_photographs(self.scene, kept, samples))
        enough = one.within(best, LIMIT)
        self._chose(
            f"samples a pixel: {1 if enough else samples**2}",
            f"{samples**2 - 1} of {samples**2} samples" if enough else "nothing",
            one.cost_beside(best) if enough else "nothing",
            f"one sample costs {one.cost_beside(best)}",
        )
        if enough:
            self._model(supersample=1)

    def _harmonics(self, kept: tuple[View, ...]) -> ColourFit:
        """The least detail of view-dependent colours that costs no more than the limit."""
        layers = [self.scene.mesh]
        fit = fit_left_out(Renderer(replace(self.config.model, widths=()), layers), self.scene)
        best = self._fitted(kept, fit)
        full = 3 * fit.bases * len(self.scene.mesh.vertices)
        gains, top = fit.gains(), self.config.model.degree

        @cache
        def stepped(i: int) -> tuple[Score, list[Tensor] | None]:
            """What a step scores, and its degrees; after the last step, those of the full size."""
            fit.degrees = degrees_for(gains, STEPS[i]) if i < len(STEPS) else None
            return (best if fit.degrees is None else self._fitted(kept, fit)), fit.degrees

        i = least(lambda i: stepped(i)[0].within(best, LIMIT), USUAL_STEP)
        score, fit.degrees = stepped(i)
        if fit.degrees is None:
            self._chose(f"harmonics: degree {top}", "nothing", "nothing", "less costs too much")
            return fit
        counts = [int((fit.degrees[0] == degree).sum()) for degree in range(top + 1)]
        shares = ", ".join(f"{n / sum(counts):.0%} of degree {d}" for d, n in enumerate(counts) if n)
        self._chose(
            f"harmonics: {shares}",
            f"{full - floats(fit.degrees, 3)} of {full} floats",
            score.cost_beside(best),
            f"elsewhere directions predict left-out colours better by less than {STEPS[i]:g} of 255",
        )
        highest = max(degree for degree, n in enumerate(counts) if n)
        self._model(degree=highest)
        return fit.reduced(highest)

    def _model(self, **changes: object) -> None:
        self.config = replace(self.config, model=replace(self.config.model, **changes))  # type: ignore[arg-type]

    def _fitted(self, kept: tuple[View, ...], fit: ColourFit) -> Score:
        """Score of colours fitted without the views that judge, one sample a pixel."""
        model = replace(self.config.model, supersample=1)
        colours = fit.coefficients(without=0 if fit.folds > 1 else None)
        return self._score(self._blending(model, self.scene, kept, colours))

    def _with_photographs(self, scene: Scene, kept: tuple[View, ...], supersample: int = 1) -> Renderer:
        """A scene's photographs over its vertices' mean colours."""
        model = replace(self.config.model, degree=0, supersample=supersample)
        return self._blending(model, scene, kept, mean_colours([scene.mesh]))

    def _blending(
        self, model: ModelConfig, scene: Scene, kept: tuple[View, ...], colours: list[Tensor]
    ) -> Renderer:
        """A scene's photographs over these colours; which of them a view needs hangs on the mesh alone."""
        renderer = blending(model, scene, kept, colours)
        photographs = renderer.photographs
        assert photographs is not None
        if self._cover is None or self._cover[0] is not scene.mesh:
            self._cover = scene.mesh, photographs.cover
        photographs.cover = self._cover[1]
        return renderer

    def _score(self, renderer: Renderer) -> Score:
        """How well a renderer predicts the judging views without their own photographs."""
        return self.judge.score(lambda view: renderer.render(view.camera, without={view.name}))
