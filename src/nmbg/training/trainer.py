"""Training one scene: from the start, and on from a checkpoint."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import nn

from nmbg.atomic import atomic_folder
from nmbg.capacity.network import size_network, unless_too_few
from nmbg.errors import NmbgError
from nmbg.losses import Perceptual
from nmbg.progress import console
from nmbg.scene import Scene
from nmbg.training import checkpoint
from nmbg.training.adversary import Adversary, adversary_for
from nmbg.training.budget import Clock
from nmbg.training.checkpoint import Progress
from nmbg.training.config import TrainConfig
from nmbg.training.initial import refuse_other_network, take_over
from nmbg.training.loop import Loop
from nmbg.training.member import Member, begin
from nmbg.training.targets import PerceptualTerm


def train(
    scene: Scene,
    config: TrainConfig,
    run: Path,
    weights: Path | None = None,
    overwrite: bool = False,
    init: Path | None = None,
) -> Path:
    """Train a scene from the start.

    Args:
        scene: the scene; only its training views are read.
        config: a preset with a budget.
        run: folder to write; it appears with the first checkpoint.
        weights: folder of pretrained weights for L_rec.
        overwrite: replace an existing run.
        init: run whose network, and discriminator, training begins with; the descriptors are the scene's own.

    Returns:
        the run folder.

    Raises:
        NmbgError: what is wrong with the scene, the weights or a folder, and the remedy.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    clock = Clock()
    config = with_layers(config, [scene], init)
    if init is None:
        config = unless_too_few(config, len(scene.train))
    else:
        refuse_other_network(init, config)
    window = smallest_window(config, [scene])
    perceptual, adversary = make_perceptual(config, weights, run), make_adversary(config, *window)
    with atomic_folder(run, overwrite) as temporary:
        scene_, config, renderer, colours = begin(scene, config, temporary, None)
        if init is not None:
            take_over(init, config, renderer.network, adversary)
        checkpoint.save_config(temporary, run, {scene.folder.resolve().name: scene.folder}, config)
        modules = {"descriptors": renderer.descriptors, "network": renderer.network}
        checkpoint.save_checkpoint(temporary, Progress(seconds=clock.seconds), modules)
    if config.stages:
        member = Member(run, scene_, config, renderer, colours)
        Loop(config, run, _Alone(member), perceptual, adversary, Progress(), {}, clock).fit()
        _size_network(member)
    return run


def resume(run: Path, weights: Path | None = None, device: str | None = None) -> Path:
    """Continue an interrupted run; in iterations or epochs, to the bit what it would have been.

    Args:
        run: run folder of one scene.
        weights: folder of pretrained weights for L_rec.
        device: "cpu" or "cuda"; None for that it was trained on.

    Returns:
        the run folder.

    Raises:
        NmbgError: the folder or its checkpoint is missing or damaged.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    source, config = checkpoint.load_one(run)
    config = replace(config, device=device or config.device)
    found = checkpoint.latest_checkpoint(run)
    if found is None:
        raise NmbgError(f"{run}: no checkpoint to resume from; train it anew with --overwrite")
    state, optimisers = checkpoint.load_progress(found), checkpoint.load_optimisers(found)
    clock = Clock(state.seconds)
    perceptual = make_perceptual(config, weights, run)
    member = Member.load(run, config, None, found)
    checkpoint.load_module(found, "network", member.renderer.network)
    # Of all views, those that were left out as well: as it was made.
    adversary = make_adversary(config, *smallest_window(config, [Scene.load(source)]))
    if adversary is not None and "adversary" in optimisers:
        adversary.load_state_dict(optimisers["adversary"])
    if config.stages:
        Loop(config, run, _Alone(member), perceptual, adversary, state, optimisers, clock).fit()
        _size_network(member)
    return run


def _size_network(member: Member) -> None:
    """Leave of the trained network what the scene needs, once, where that is asked for."""
    run, config = member.folder, member.config
    if config.capacity == "full" or "network" in {choice.part for choice in config.choices}:
        return
    renderer, scene = member.renderer, member.scene
    config = size_network(scene, config, renderer, member.training)
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    with atomic_folder(run, overwrite=True) as temporary:
        # The checkpoint is written anew, without its optimisers.
        shutil.copytree(run, temporary, ignore=shutil.ignore_patterns(found.parent.name), dirs_exist_ok=True)
        checkpoint.save_config(temporary, run, {scene.folder.resolve().name: scene.folder}, config)
        modules = {"descriptors": renderer.descriptors, "network": renderer.network}
        checkpoint.save_checkpoint(temporary, checkpoint.load_progress(found), modules)


class _Alone:
    """One scene, whose run folder is the run's."""

    def __init__(self, member: Member) -> None:
        self._member = member
        self.network: nn.Module | None = member.renderer.network
        self.counts, self.length, self.several = [len(member.training)], 0, False

    def member(self, scene: int) -> Member:
        """The scene."""
        return self._member

    def save(self, progress: Progress, optimisers: dict[str, Any]) -> None:
        """Write everything into one checkpoint."""
        member = self._member
        modules = {"descriptors": member.renderer.descriptors, "network": self.network}
        states = {**optimisers, "descriptors": member.states}
        checkpoint.drop_others(checkpoint.save_checkpoint(member.folder, progress, modules, states))


def make_perceptual(config: TrainConfig, weights: Path | None, folder: Path | None) -> PerceptualTerm | None:
    """L_rec, where a stage asks for it; `folder` takes features that memory does not."""
    if config.perceptual == "none" or not any(stage.perceptual for stage in config.stages):
        return None
    loss = Perceptual(config.perceptual, weights).to(config.device)
    return PerceptualTerm(loss, config.cache_gib / 2 if config.whole_frames else 0.0, folder)


def with_layers(config: TrainConfig, scenes: Sequence[Scene], init: Path | None) -> TrainConfig:
    """A configuration with a second layer only where a scene has one, or the network that it begins with."""
    wanted = max(scene.layers for scene in scenes)
    if init is not None:
        wanted = checkpoint.load_config(init)[1].model.layers
    if wanted >= config.model.layers:
        return config
    console.print("one layer: preprocess found no background apart (its --layers 2 makes one)")
    return replace(config, model=replace(config.model, layers=wanted))


def smallest_window(config: TrainConfig, scenes: Sequence[Scene]) -> tuple[int, int]:
    """The least width and the least height of what training looks at, pixels.

    Raises:
        NmbgError: too small for the network.
    """
    cameras = [view.camera for scene in scenes for view in scene.train]
    width, height = (
        round(config.window * min(sides))
        for sides in zip(*((camera.width, camera.height) for camera in cameras), strict=True)
    )
    coarsest = 2 ** (config.model.levels - 1)
    if config.model.widths and max(width, height) <= coarsest:
        raise NmbgError(
            f"windows of {width}×{height} pixels are too small for a network of {config.model.levels} "
            f"levels: take larger images, or a larger --window, of more than {coarsest} pixels"
        )
    return width, height


def make_adversary(config: TrainConfig, width: int, height: int) -> Adversary | None:
    """L_GAN, where a stage asks for it, for windows of width × height pixels."""
    if not any(stage.adversarial for stage in config.stages):
        return None
    return adversary_for(width, height, config)
