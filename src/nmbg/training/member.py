"""A scene in training: geometry, descriptors, photographs, and what its views show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from nmbg.cameras import Camera
from nmbg.capacity.plan import plan
from nmbg.model.renderer import Prepared, Renderer
from nmbg.progress import console
from nmbg.reconstruct.poses import refine_poses
from nmbg.reconstruct.refinement import refine_geometry, views_for
from nmbg.scene import Scene, View
from nmbg.training import checkpoint
from nmbg.training.artificial import ArtificialCameras
from nmbg.training.camera_picture import camera_picture
from nmbg.training.config import AS_TAKEN, TrainConfig
from nmbg.training.exposures import find_exposures
from nmbg.training.inspection import doubtful, without
from nmbg.training.left_out import LeftOut, can_leave_out, fit_left_out
from nmbg.training.optimiser import Part, descriptors_part
from nmbg.training.run_views import load_exposures, load_views, save_views
from nmbg.training.start import ColourFit, mean_colours
from nmbg.training.views import Example, Views, random_window

PICTURED = 200  # artificial cameras in the run's picture
SEEN = 5  # passes before points are hidden: what is new cannot be over-fitted yet


class Member:
    """A scene in training, beside its folder, which is a run folder of this one scene.

    Args:
        folder: the run folder; its photographs are read.
        scene: the scene, with the run's geometry.
        config: how it is trained.
        renderer: its renderer.
        fit: the closed-form colours that it began with, where they are at hand.
    """

    def __init__(
        self,
        folder: Path,
        scene: Scene,
        config: TrainConfig,
        renderer: Renderer,
        fit: ColourFit | None = None,
    ) -> None:
        self.folder, self.scene, self.config, self.renderer = folder, scene, config, renderer
        checkpoint.remember_photographs(folder, renderer, config.cache_gib)
        if fit is None and can_leave_out(config):
            fit = fit_left_out(renderer, scene)
        renderer.exposures = load_exposures(folder)
        self.left_out = None if fit is None or not can_leave_out(config) else LeftOut(renderer, fit)
        self.training, self.validation = make_views(scene, config, renderer, self.left_out, folder)
        self.artificial = ArtificialCameras(scene) if config.artificial_views else None
        self.steps = 0  # that looked at it
        self.stage = -1  # whose rates the descriptors have
        self._parts: list[Part] = []

    @staticmethod
    def load(folder: Path, config: TrainConfig, network: nn.Module | None, at: Path) -> Member:
        """Load a scene from its run folder, as a checkpoint of it says, but for the network."""
        source, _ = checkpoint.load_one(folder)
        mesh = Scene.load(folder / checkpoint.SCENE).mesh
        scene = replace(load_views(folder, Scene.load(source)), mesh=mesh)
        renderer = checkpoint.build_renderer(scene, config, network)
        checkpoint.load_module(at, "descriptors", renderer.descriptors)
        member = Member(folder, scene, config, renderer)
        progress = checkpoint.load_progress(at)
        member.steps = progress.step
        states = checkpoint.load_optimisers(at)
        if states.get("descriptors"):
            for (optimiser, _), state in zip(
                member.parts(progress.stage), states["descriptors"], strict=True
            ):
                optimiser.load_state_dict(state)
        return member

    def parts(self, stage: int) -> list[Part]:
        """What trains the descriptors in a stage, its index; another stage begins anew."""
        if stage != self.stage:
            self.stage, self._parts = stage, descriptors_part(self.renderer, self.config.stages[stage])
        return self._parts

    @property
    def states(self) -> list[dict[str, Any]]:
        """States of the descriptors' optimiser, for a checkpoint."""
        return [optimiser.state_dict() for optimiser, _ in self._parts]

    @property
    def nbytes(self) -> int:
        """Memory held, bytes; the optimiser's moments count as soon as there may be some."""
        coefficients = sum(p.nbytes for p in self.renderer.descriptors.parameters())
        geometry = sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in self.renderer.layers)
        holders = (self.training, self.validation, self.left_out, self.renderer.photographs)
        return 3 * coefficients + geometry + sum(part.nbytes for part in holders if part is not None)

    def example(self, view: int | None, step: int) -> Example:
        """What a step looks at: a training view, or an artificial one for None; with points missing."""
        generator = torch.Generator().manual_seed(self.config.seed * 1_000_003 + step)
        example = self._example(view, generator)
        if not self.config.hide_points or self.steps < SEEN * len(self.training):
            return example
        assert isinstance(example.sight, list)
        share = self.config.hide_points * float(torch.rand((), generator=generator))
        return replace(example, sight=[layer.without_points(share, generator) for layer in example.sight])

    def photograph(self, generator: torch.Generator) -> tuple[Tensor, Tensor | None]:
        """Some training photograph, [3, H, W] uint8, as large a part of it as a step sees, and its mask."""
        config, i = self.config, int(torch.randint(len(self.training), (), generator=generator))
        if config.whole_frames:
            return self.training.photograph(i)
        return self.training.cut(i, config.window, config.zoom, generator)[1:]

    def _example(self, view: int | None, generator: torch.Generator) -> Example:
        config = self.config
        if view is None:
            assert self.artificial is not None
            camera = self.artificial.draw(generator)
            camera, *_ = random_window(camera, config.window, config.zoom, generator)
            # Shaded under a gradient, unlike what see() gives without photographs.
            see = self.renderer.see if config.model.sources else self.renderer.rasterize
            with torch.no_grad():
                sight = see(camera)
            mask = shown(sight, camera) if self.training.masked else None
            return Example("an artificial view", camera, sight, None, mask)
        if config.whole_frames:
            return self.training.frame(view)
        if config.zoom == AS_TAKEN and can_leave_out(config):
            return self.training.crop(view, config.window, generator)
        return self.training.window(view, config.window, config.zoom, generator)


def shown(sight: Prepared, camera: Camera) -> Tensor | None:
    """Where a view shows any geometry, [H, W] bool; None of what is not rasterized."""
    if not isinstance(sight, list):
        return None
    found = torch.zeros(camera.height, camera.width, dtype=torch.bool)
    for layer in sight:
        finest = layer.levels[0]
        for index in (finest.face, finest.index):
            if index is not None:
                samples = index.shape[0] // finest.camera.height
                found |= index[::samples, ::samples][: camera.height, : camera.width] >= 0
    return found


def begin(
    scene: Scene, config: TrainConfig, folder: Path, network: nn.Module | None
) -> tuple[Scene, TrainConfig, Renderer, ColourFit | None]:
    """Write a scene's run folder up to its first checkpoint.

    Args:
        scene: the scene; only its training views are read.
        config: how it is trained.
        folder: to be filled.
        network: of the run, when several scenes share it.

    Returns:
        the scene without doubtful views and as it was refined, the configuration with the size that was
        chosen, the renderer, and the closed-form colours when
        there are any.
    """
    left_out = doubtful(scene) if config.inspect else {}
    for name, why in left_out.items():
        console.print(f"{name} is left out: {why}")
    scene = without(scene, left_out)
    if "poses" in config.refine:
        scene = refine_poses(scene)
    if "geometry" in config.refine:
        scene = replace(scene, mesh=refine_geometry(scene, views=views_for(config.minutes)))
    exposures = find_exposures(scene, split_training(scene, config)[0]) if config.exposure else None
    save_views(folder, scene, left_out, exposures)
    planned = plan(scene, config)
    scene, config = planned.scene, planned.config
    renderer = checkpoint.build_renderer(scene, config, network)
    checkpoint.save_scene(folder, scene, planned.photographs, planned.storage)
    fit = planned.fit or _fit_colours(scene, config, renderer)
    if config.start == "mean":
        renderer.set_colours(mean_colours(renderer.layers))
    elif fit is not None:
        renderer.set_colours(fit.coefficients())
    if config.artificial_views:
        artificial, generator = ArtificialCameras(scene), torch.Generator().manual_seed(config.seed)
        drawn = [artificial.draw(generator) for _ in range(PICTURED)]
        (folder / "cameras.svg").write_text(camera_picture(scene, drawn))
    return scene, config, renderer, fit


def split_training(scene: Scene, config: TrainConfig) -> tuple[tuple[View, ...], tuple[View, ...]]:
    """Training views, and those of them that are kept aside, spread evenly over the names."""
    views = scene.train
    aside = min(config.validation_views, len(views) - 1)
    chosen = {round((i + 0.5) * len(views) / aside) for i in range(aside)}

    def pick(which: bool) -> tuple[View, ...]:
        return tuple(view for i, view in enumerate(views) if (i in chosen) is which)

    return pick(False), pick(True)


def _fit_colours(scene: Scene, config: TrainConfig, renderer: Renderer) -> ColourFit | None:
    """The closed-form start. What leaves each view out anyway may use those kept aside too."""
    if config.start != "fit":
        return None
    if can_leave_out(config):
        return fit_left_out(renderer, scene)
    return ColourFit(renderer.layers, scene, split_training(scene, config)[0], config.model.bases)


def make_views(
    scene: Scene, config: TrainConfig, renderer: Renderer, left_out: LeftOut | None, folder: Path | None
) -> tuple[Views, Views]:
    """Examples of both parts of the training views; what is left out of them, where anything is.

    Those that memory does not take lie in `folder`.
    """

    def rasterized(camera: Camera, view: View) -> Prepared:
        return renderer.rasterize(camera)

    see: Callable[[Camera, View], Prepared] = rasterized if left_out is None else left_out.see
    training, aside = split_training(scene, config)
    frames = config.whole_frames or (config.zoom == AS_TAKEN and can_leave_out(config))
    # Half of the memory is for what the loss keeps, where it keeps something.
    cache = config.cache_gib / (2 if config.whole_frames and config.perceptual != "none" else 1)
    exposures = renderer.exposures
    return (
        Views(scene, training, see, cache if frames else 0.0, folder, exposures),
        Views(scene, aside, see, cache, folder, exposures),
    )
