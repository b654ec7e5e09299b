"""Full training (paper, section 3.4): one network over several scenes, each with descriptors of its own.

A run's scenes/NAME is itself a run folder of one scene: evaluate it, copy it elsewhere, or remove it when it
is no longer wanted. Scenes are loaded for the steps that look at them and stay while memory lasts. Started by
torchrun, each process trains some of the scenes, and the network's gradients are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from nmbg.atomic import atomic_folder, refuse_existing
from nmbg.errors import NmbgError
from nmbg.model.renderer import make_network
from nmbg.progress import console
from nmbg.scene import Scene
from nmbg.training import checkpoint, processes
from nmbg.training.budget import Clock
from nmbg.training.checkpoint import SCENES, Progress
from nmbg.training.config import TrainConfig
from nmbg.training.initial import take_over
from nmbg.training.loop import Loop
from nmbg.training.member import Member, begin, split_training
from nmbg.training.run_views import load_views
from nmbg.training.schedule import extra_steps, shard
from nmbg.training.shelf import GIB
from nmbg.training.trainer import make_adversary, make_perceptual, smallest_window, with_layers

EPOCHS = 15  # paper, section 4


def train_together(
    folders: Sequence[Path],
    config: TrainConfig,
    run: Path,
    weights: Path | None = None,
    overwrite: bool = False,
    init: Path | None = None,
) -> Path:
    """Train several scenes with one network, in all processes that torchrun started.

    Args:
        folders: scene folders; their last names are the scenes' names.
        config: a preset with a network, and a budget.
        run: folder to write; it appears with the first checkpoint.
        weights: folder of pretrained weights for L_rec.
        overwrite: replace an existing run.
        init: run whose network training begins with.

    Returns:
        the run folder.

    Raises:
        NmbgError: what is wrong with the scenes, the weights or a folder, and the remedy.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    clock = Clock()
    scenes = {folder.resolve().name: folder for folder in folders}
    config = with_layers(config, [Scene.load(folder) for folder in folders], init)
    _check(scenes, folders, config)
    company = _Company.of(run, scenes, config, clock)
    perceptual = make_perceptual(config, weights, run)
    adversary = make_adversary(config, *company.window)
    if init is not None:
        take_over(init, config, company.bare, adversary)
    first = processes.rank() == 0
    if first:
        refuse_existing(run, overwrite)
    processes.wait()
    if first:
        with atomic_folder(run, overwrite) as temporary:
            company.begin(processes.gathered(temporary)[0])
            checkpoint.save_config(temporary, run, scenes, config)
            progress = Progress(seconds=clock.seconds, scenes=dict.fromkeys(scenes, 0))
            checkpoint.save_checkpoint(temporary, progress, {"network": company.bare})
            processes.wait()  # until the others have written their scenes, too
    else:
        company.begin(processes.gathered(Path())[0])
        processes.wait()
    processes.wait()  # until the folder stands at its place
    company.share()
    Loop(config, run, company, perceptual, adversary, Progress(), {}, clock).fit()
    return run


def resume_together(run: Path, weights: Path | None = None, device: str | None = None) -> Path:
    """Continue an interrupted run over several scenes, with any number of processes up to the scenes'.

    Args:
        run: run folder.
        weights: folder of pretrained weights for L_rec.
        device: "cpu" or "cuda"; None for that it was trained on.

    Returns:
        the run folder.

    Raises:
        NmbgError: the folder, a scene or a checkpoint is missing or damaged.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    scenes, config = checkpoint.load_config(run)
    config = replace(config, device=device or config.device)
    found = checkpoint.latest_checkpoint(run)
    if found is None:
        raise NmbgError(f"{run}: no checkpoint to resume from; train it anew with --overwrite")
    _check(scenes, list(scenes.values()), config)
    state, optimisers = checkpoint.load_progress(found), checkpoint.load_optimisers(found)
    clock = Clock(state.seconds)
    company = _Company.of(run, scenes, config, clock)
    company.written = {name: state.scenes[name] for name in company.written}
    checkpoint.load_module(found, "network", company.bare)
    perceptual = make_perceptual(config, weights, run)
    adversary = make_adversary(config, *company.window)
    if adversary is not None and "adversary" in optimisers:
        adversary.load_state_dict(optimisers["adversary"])
    company.share()
    Loop(config, run, company, perceptual, adversary, state, optimisers, clock).fit()
    return run


def _check(scenes: Mapping[str, Path], folders: Sequence[Path], config: TrainConfig) -> None:
    """Refuse what cannot be trained together."""
    if len(scenes) < len(folders):
        raise NmbgError("two scene folders have the same last name, or one is given twice; rename one")
    if not config.model.widths or not all(stage.network for stage in config.stages):
        raise NmbgError(
            f"--preset {config.preset} has no network that scenes could share; train them one by one"
        )
    if processes.size() > len(scenes):
        raise NmbgError(
            f"{processes.size()} processes for {len(scenes)} scenes; start at most one process per scene"
        )
    every = processes.gathered((list(scenes), config))
    if any(other != every[0] for other in every):
        raise NmbgError("the processes were given different scenes or options; start all with the same ones")


class _Company:
    """The scenes of this process; those in memory are the last that were looked at.

    Args:
        run: run folder.
        window: least width and height of what training looks at in any scene.
        config: how they are trained.
        scenes: folders of this process's scenes.
        clock: of the run.
    """

    def __init__(
        self,
        run: Path,
        scenes: Mapping[str, Path],
        window: tuple[int, int],
        config: TrainConfig,
        clock: Clock,
    ) -> None:
        self.run, self.scenes, self.names, self.config = run, scenes, list(scenes), config
        self.window = window
        # Known when the scenes' folders are complete: share().
        self.counts: list[int] = []
        self.length = 0
        torch.manual_seed(config.seed)
        network = make_network(config.model)
        assert network is not None  # _check
        self.bare: nn.Module = network.to(config.device)
        self.network: nn.Module | None = self.bare
        self.several = True
        self.clock = clock
        self.written = dict.fromkeys(self.names, 0)  # steps of each scene's own checkpoint that is valid
        self._loaded: dict[str, Member] = {}

    @staticmethod
    def of(run: Path, scenes: Mapping[str, Path], config: TrainConfig, clock: Clock) -> _Company:
        """The part of a run's scenes that this process trains."""
        loaded = [Scene.load(folder) for folder in scenes.values()]
        counts = [len(split_training(scene, config)[0]) for scene in loaded]
        dealt = shard(counts, processes.size())
        mine, names = dealt[processes.rank()], list(scenes)
        window = smallest_window(config, loaded)
        return _Company(run, {names[i]: scenes[names[i]] for i in mine}, window, config, clock)

    def share(self) -> None:
        """From now on the network's gradients are averaged; the scenes' folders are complete."""
        self.network = processes.shared(self.bare)
        for name, folder in self.scenes.items():
            scene = load_views(self.run / SCENES / name, Scene.load(folder))
            self.counts.append(len(split_training(scene, self.config)[0]))
        share = self.config.artificial_views
        (length,) = processes.largest([sum(count + extra_steps(count, share) for count in self.counts)])
        self.length = int(length)

    def begin(self, run: Path) -> None:
        """Write the scenes' folders below that of a run, up to their first checkpoints."""
        for name, folder in self.scenes.items():
            console.print(f"scene {name}")
            place = run / SCENES / name
            place.mkdir(parents=True)
            _, _, renderer, _ = begin(Scene.load(folder), self.config, place, self.bare)
            checkpoint.save_config(place, self.run / SCENES / name, {name: folder}, self.config)
            modules = {"descriptors": renderer.descriptors, "network": self.bare}
            checkpoint.save_checkpoint(place, Progress(), modules)

    def member(self, scene: int) -> Member:
        """One of the scenes; others make room for it when the memory of --cache is full."""
        name = self.names[scene]
        member = self._loaded.pop(name, None)
        if member is None:
            folder = self.run / SCENES / name
            at = folder / "checkpoints" / f"{self.written[name]:08d}"
            share = replace(self.config, cache_gib=self.config.cache_gib / len(self.names))
            member = Member.load(folder, share, self.network, at)
        self._loaded[name] = member  # the last one looked at
        while len(self._loaded) > 1 and self._held() > self.config.cache_gib * GIB:
            oldest = next(iter(self._loaded))
            self._write(oldest, self._loaded.pop(oldest))
        return member

    def save(self, progress: Progress, optimisers: dict[str, Any]) -> None:
        """Write the scenes' checkpoints, then the run's, which names them; then drop the older ones."""
        for name, member in self._loaded.items():
            self._write(name, member)
        steps = {name: step for part in processes.gathered(self.written) for name, step in part.items()}
        if processes.rank() == 0:
            modules = {"network": self.bare}
            whole = checkpoint.save_checkpoint(self.run, replace(progress, scenes=steps), modules, optimisers)
            checkpoint.drop_others(whole)
        processes.wait()
        for name, step in self.written.items():
            own = self.run / SCENES / name / "checkpoints" / f"{step:08d}"
            checkpoint.save_module(own, "network", self.bare)
            checkpoint.drop_others(own)

    def _held(self) -> int:
        return sum(member.nbytes for member in self._loaded.values())

    def _write(self, name: str, member: Member) -> None:
        if member.steps > self.written[name]:
            modules = {"descriptors": member.renderer.descriptors, "network": self.bare}
            progress = Progress(step=member.steps, stage=member.stage, seconds=self.clock.seconds)
            checkpoint.save_checkpoint(member.folder, progress, modules, {"descriptors": member.states})
            self.written[name] = member.steps
