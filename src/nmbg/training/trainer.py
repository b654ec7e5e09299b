"""The training loop."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType

import torch
from torch import Tensor

from nmbg.atomic import atomic_folder
from nmbg.cameras import Camera
from nmbg.capacity import choose_photographs
from nmbg.errors import NmbgError
from nmbg.losses import Perceptual, l1
from nmbg.model.renderer import Prepared, Renderer
from nmbg.progress import console, progress_bar
from nmbg.reconstruct.refinement import refine_geometry, views_for
from nmbg.scene import Scene, View
from nmbg.training import checkpoint
from nmbg.training.budget import Budget, Clock
from nmbg.training.checkpoint import Progress
from nmbg.training.config import Stage, TrainConfig
from nmbg.training.left_out import LeftOut, can_leave_out, fit_left_out
from nmbg.training.log import Log
from nmbg.training.optimiser import Optimiser
from nmbg.training.start import ColourFit, mean_colours
from nmbg.training.targets import PerceptualTerm
from nmbg.training.views import Example, Views

REPORTS = 20  # progress figures in a run
SAVE_EVERY = 300.0  # seconds


def train(
    scene: Scene, config: TrainConfig, run: Path, weights: Path | None = None, overwrite: bool = False
) -> Path:
    """Train a scene from the start.

    Args:
        scene: the scene; only its training views are read.
        config: a preset with a budget.
        run: folder to write; it appears with the first checkpoint.
        weights: folder of pretrained weights for L_rec.
        overwrite: replace an existing run.

    Returns:
        the run folder.

    Raises:
        NmbgError: what is wrong with the scene, the weights or the folder, and the remedy.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    clock = Clock()
    perceptual = _perceptual(config, weights)
    with atomic_folder(run, overwrite) as temporary:
        if config.refine == "geometry":
            scene = replace(scene, mesh=refine_geometry(scene, views=views_for(config.minutes)))
        renderer = checkpoint.build_renderer(scene, config)
        kept = choose_photographs(scene, config.photos, config.model) if config.model.sources else ()
        checkpoint.save_scene(temporary, scene, kept)
        fit = _fit_colours(scene, config, renderer)
        if config.start == "mean":
            renderer.set_colours(mean_colours(renderer.layers))
        elif fit is not None:
            renderer.set_colours(fit.coefficients())
        checkpoint.save_config(temporary, scene, config)
        checkpoint.save_checkpoint(temporary, renderer, Progress(seconds=clock.seconds))
    if config.stages:
        checkpoint.remember_photographs(run, renderer)
        training, validation = _views(scene, config, renderer, fit)
        _fit(config, run, renderer, perceptual, training, validation, Progress(), clock)
    return run


def resume(run: Path, weights: Path | None = None) -> Path:
    """Continue an interrupted run; in iterations or epochs, to the bit what it would have been.

    Args:
        run: run folder.
        weights: folder of pretrained weights for L_rec.

    Returns:
        the run folder.

    Raises:
        NmbgError: the folder or its checkpoint is missing or damaged.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    folder, config = checkpoint.load_config(run)
    found = checkpoint.latest_checkpoint(run)
    if found is None:
        raise NmbgError(f"{run}: no checkpoint to resume from; train it anew with --overwrite")
    state = checkpoint.load_progress(found)
    clock = Clock(state.seconds)
    perceptual = _perceptual(config, weights)
    scene = replace(Scene.load(folder), mesh=Scene.load(run / checkpoint.SCENE).mesh)
    renderer = checkpoint.build_renderer(scene, config)
    checkpoint.load_model(found, renderer)
    checkpoint.remember_photographs(run, renderer)
    fit = _fit_colours(scene, config, renderer) if can_leave_out(config) else None
    training, validation = _views(scene, config, renderer, fit)
    _fit(config, run, renderer, perceptual, training, validation, state, clock)
    return run


def _fit(
    config: TrainConfig,
    run: Path,
    renderer: Renderer,
    perceptual: PerceptualTerm | None,
    training: Views,
    validation: Views,
    state: Progress,
    clock: Clock,
) -> None:
    """Run the stages from `state` to the end of the budget, or until interrupted."""
    budget = Budget(config, len(training), clock)
    step, optimiser, progress = state.step, None, budget.progress(state.step)
    saved, stage_index = clock.seconds, state.stage
    renderer.train()
    with Log(run, step) as log, _interruptible() as interrupted, progress_bar() as bar:
        task = bar.add_task(f"training {config.preset}", total=100)
        while progress < 1 and not interrupted:
            index, done = budget.stage(progress)
            stage = config.stages[index]
            if optimiser is None or index != stage_index:
                optimiser = Optimiser(renderer, stage)
                if index == state.stage and state.optimiser is not None:
                    optimiser.load_state_dict(state.optimiser)
                stage_index, state = index, replace(state, optimiser=None)
            example = _draw(training, config, step)
            with torch.autocast(config.device, torch.bfloat16, enabled=config.bf16):
                terms = _loss(renderer, stage, perceptual, example)
            loss = terms["loss"]
            if not torch.isfinite(loss):
                raise NmbgError(f"{example.name}: the loss is not finite at step {step}; go on with --resume")
            optimiser.step(loss, done)
            step += 1

            report = int(REPORTS * progress)
            progress = budget.progress(step)
            bar.update(task, completed=100 * progress)
            if int(REPORTS * progress) > report or progress >= 1:
                figures = {name: value.item() for name, value in terms.items()}
                if len(validation):
                    figures["validation_psnr"] = _validate(renderer, validation, stage)
                log.write(step, seconds=clock.seconds, progress=progress, stage=index, **figures)
            if clock.seconds - saved > SAVE_EVERY:
                saved = clock.seconds
                _save(run, renderer, step, clock, stage_index, optimiser)
    if optimiser is not None:
        _save(run, renderer, step, clock, stage_index, optimiser)
    if interrupted:
        console.print(f"interrupted at step {step}; go on with: nmbg train --resume --output {run}")
        raise KeyboardInterrupt


def _save(run: Path, renderer: Renderer, step: int, clock: Clock, stage: int, optimiser: Optimiser) -> None:
    checkpoint.save_checkpoint(run, renderer, Progress(step, clock.seconds, stage, optimiser.state_dict()))


def _perceptual(config: TrainConfig, weights: Path | None) -> PerceptualTerm | None:
    if config.perceptual == "none" or not any(stage.perceptual for stage in config.stages):
        return None
    loss = Perceptual(config.perceptual, weights).to(config.device)
    return PerceptualTerm(loss, config.cache_gib / 2 if _whole(config) else 0.0)


def _whole(config: TrainConfig) -> bool:
    """Whether every step sees a whole frame, the same in every epoch."""
    return config.zoom == 1 and config.window == 1


def _split(scene: Scene, config: TrainConfig) -> tuple[tuple[View, ...], tuple[View, ...]]:
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
    return ColourFit(renderer.layers, scene, _split(scene, config)[0], config.model.bases)


def _views(
    scene: Scene, config: TrainConfig, renderer: Renderer, fit: ColourFit | None
) -> tuple[Views, Views]:
    """Examples of both parts of the training views."""

    def rasterized(camera: Camera, view: View) -> Prepared:
        return renderer.rasterize(camera)

    see: Callable[[Camera, View], Prepared] = rasterized
    if can_leave_out(config):
        assert fit is not None  # ModelConfig and the presets: photographs stand on a fitted mesh
        see = LeftOut(renderer, fit).see
    training, aside = _split(scene, config)
    frames = _whole(config) or (config.zoom == 1 and can_leave_out(config))
    # Half of the memory is for what the loss keeps, where it keeps something.
    cache = config.cache_gib / (2 if _whole(config) and config.perceptual != "none" else 1)
    return Views(scene, training, see, cache if frames else 0.0), Views(scene, aside, see, cache)


def _draw(views: Views, config: TrainConfig, step: int) -> Example:
    """The example of a step: a function of seed and step alone, so that a resumed run draws the same."""
    epoch, position = divmod(step, len(views))
    generator = torch.Generator().manual_seed(config.seed * 1_000_003 + epoch)
    i = int(torch.randperm(len(views), generator=generator)[position])
    if _whole(config):
        return views.frame(i)
    generator.manual_seed(config.seed * 1_000_003 + step)
    if config.zoom == 1 and can_leave_out(config):
        return views.crop(i, config.window, 2 ** (config.model.levels - 1), generator)
    return views.window(i, config.window, config.zoom, generator)


def _render(renderer: Renderer, stage: Stage, example: Example) -> Tensor:
    """What the stage trains: the whole model, or the colour on the mesh."""
    if stage.network:
        image: Tensor = renderer(example.sight, example.camera)
        return image
    assert isinstance(example.sight, list)  # photographs are gathered for a network alone
    return renderer.colour(example.sight, example.camera)


def _loss(
    renderer: Renderer, stage: Stage, perceptual: PerceptualTerm | None, example: Example
) -> dict[str, Tensor]:
    """The stage's loss and its terms."""
    image = _render(renderer, stage, example)[None]
    target = (example.image.to(image.device) / 255)[None]
    mask = None
    if example.mask is not None:
        mask = example.mask.to(image.device)[None, None].float()
        # Features near the mask's border also see pixels beyond it: both show the same black there.
        image, target = image * mask, target * mask
    terms = {"l1": l1(image, target, mask)}
    terms["loss"] = stage.l1 * terms["l1"]
    if stage.perceptual and perceptual is not None:
        wanted = perceptual.of_target(example.name, target)
        terms["perceptual"] = perceptual.loss.distance(perceptual.loss.features(image), wanted, mask)
        terms["loss"] = terms["loss"] + stage.perceptual * terms["perceptual"]
    return terms


@torch.no_grad()
def _validate(renderer: Renderer, views: Views, stage: Stage) -> float:
    """Mean PSNR over the training views kept aside, dB."""
    renderer.eval()
    total = 0.0
    for i in range(len(views)):
        example = views.frame(i)
        image = _render(renderer, stage, example).clamp(0, 1).cpu()
        error = (image - example.image / 255) ** 2
        if example.mask is not None:
            error = error * example.mask
        total += -10 * float(torch.log10(error.mean().clamp_min(1e-10)))
    renderer.train()
    return total / len(views)


@contextmanager
def _interruptible() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM instead of dying in the middle of a step; a second one kills."""
    caught: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        caught.append(number)
        signal.signal(number, signal.SIG_DFL)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
