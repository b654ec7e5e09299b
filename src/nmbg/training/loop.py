"""The training loop: what every step does, over one scene or many, in one process or many."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from nmbg.errors import NmbgError
from nmbg.losses import l1
from nmbg.model.renderer import Renderer
from nmbg.progress import console, progress_bar
from nmbg.training import processes
from nmbg.training.adversary import Adversary
from nmbg.training.budget import Budget, Clock
from nmbg.training.checkpoint import Progress
from nmbg.training.config import Stage, TrainConfig
from nmbg.training.log import COLUMNS, Log
from nmbg.training.member import Member
from nmbg.training.optimiser import Part, descend, differentiate, network_part
from nmbg.training.schedule import Schedule
from nmbg.training.targets import PerceptualTerm
from nmbg.training.views import Example, Views

REPORTS = 20  # progress figures in a run
SAVE_EVERY = 300.0  # seconds
# After so many steps in a row whose loss is not finite, the rates fall to this share of what they were; after
# more, training ends.
PATIENCE, CAUTION, HOPELESS = 3, 0.5, 50


class Crew(Protocol):
    """The scenes that this process trains, and how they are written down.

    Attributes:
        network: shared by all of them, or None.
        counts: their training views.
        length: least number of steps of a pass: that of the process with the most images.
    """

    network: nn.Module | None
    counts: list[int]
    length: int

    def member(self, scene: int) -> Member:
        """One of the scenes, loaded."""
        ...

    def save(self, progress: Progress, optimisers: dict[str, Any]) -> None:
        """Write a checkpoint: the scenes', then the run's, with what belongs to all of them."""
        ...


def fit(
    config: TrainConfig,
    run: Path,
    crew: Crew,
    perceptual: PerceptualTerm | None,
    adversary: Adversary | None,
    state: Progress,
    optimisers: dict[str, Any],
    clock: Clock,
) -> None:
    """Train from `state` to the end of the budget, or until interrupted.

    Raises:
        NmbgError: losses stay without a finite value.
        KeyboardInterrupt: interrupted; a checkpoint was saved.
    """
    schedule = Schedule(crew.counts, config.artificial_views, config.seed, crew.length)
    if state.length and state.length != schedule.length:  # other processes: the same share of the passes
        state = replace(state, step=round(state.step * schedule.length / state.length))
    budget = Budget(config, schedule.length, clock)
    step, stage_index, caution = state.step, state.stage, state.caution
    skipped, in_a_row, saved = Counter(state.skipped), 0, clock.seconds
    shared: list[Part] | None = None
    (progress,) = processes.largest([budget.progress(step)])

    def save() -> None:
        states = {"network": [optimiser.state_dict() for optimiser, _ in shared or []]}
        if adversary is not None:
            states["adversary"] = adversary.state_dict()  # type: ignore[assignment]
        now = Progress(step, schedule.length, clock.seconds, stage_index, caution, dict(skipped))
        crew.save(now, states)

    with Log(run, step) as log, _interruptible() as interrupted, progress_bar() as bar:
        task = bar.add_task(f"training {config.preset}", total=100)
        stopped = False
        while progress < 1 and not stopped:
            index, done = budget.stage(progress)
            stage = config.stages[index]
            if shared is None or index != stage_index:
                shared = network_part(crew.network, stage)
                if index == state.stage and "network" in optimisers:
                    for (optimiser, _), found in zip(shared, optimisers.pop("network"), strict=True):
                        optimiser.load_state_dict(found)
                stage_index = index
            turn = schedule.turn(step)
            member = crew.member(turn.scene)
            member.renderer.train()
            parts = [*shared, *member.parts(stage_index)]
            example = member.example(turn.view, step)
            statistics = _statistics(crew.network)
            generator = torch.Generator().manual_seed(config.seed * 1_000_003 + step + 1)
            with torch.autocast(config.device, torch.bfloat16, enabled=config.bf16):
                image = render(member.renderer, stage, example)[None]
                terms = losses(image, stage, perceptual, adversary, example, generator)
            with processes.others_may_end():
                finite = differentiate(terms["loss"], parts)
            # Clocks differ: what hangs on them is agreed on, too.
            bad, stop, due, reached = processes.largest(
                [
                    not finite,
                    bool(interrupted),
                    clock.seconds - saved > SAVE_EVERY,
                    budget.progress(step + 1),
                ]
            )
            member.steps += 1
            step, stopped = step + 1, bool(stop)
            if bad:
                in_a_row += 1
                _restore(crew.network, statistics)
                if not finite:
                    skipped[example.name] += 1
                    _tell(example.name, step, skipped)
                if in_a_row % PATIENCE == 0:
                    caution *= CAUTION
                if in_a_row > HOPELESS:
                    raise NmbgError(
                        f"{example.name}: {in_a_row} steps in a row without a finite loss; the last "
                        "checkpoint is sound: look at the photographs named above, or train anew"
                    )
            else:
                in_a_row = 0
                descend(parts, caution * ((1 - done) if stage.decay else 1.0))
                if adversary is not None and stage.adversarial:
                    terms["discriminator"] = adversary.learn(
                        image, _photograph(member, example, generator), generator
                    )

            report = int(REPORTS * progress)
            progress = reached
            bar.update(task, completed=100 * progress)
            if not bad and (int(REPORTS * progress) > report or progress >= 1):
                figures = {name: value.item() for name, value in terms.items()}
                if "adversarial" in figures:
                    figures["adversarial_share"] = (
                        stage.adversarial * figures["adversarial"] / figures["loss"]
                    )
                if len(member.validation):
                    figures["validation_psnr"] = _validate(member.renderer, member.validation, stage)
                log.write(
                    step,
                    seconds=clock.seconds,
                    progress=progress,
                    stage=index,
                    scene=member.folder.name,
                    **_mean(figures),
                )
            if due and not stopped and progress < 1:
                saved = clock.seconds
                save()
    if shared is not None:
        save()
    for name, times in skipped.items():
        console.print(f"{name}: {times} steps were left out, because the loss was not finite")
    if stopped:
        again = f"nmbg train --resume --output {run}"
        if processes.rank() == 0:
            console.print(f"interrupted at step {step}; go on with: {again}")
        raise KeyboardInterrupt


def _mean(figures: dict[str, float]) -> dict[str, float]:
    """Figures as means over the processes; what only some of them have, of these alone."""
    names = [name for name in COLUMNS if name not in ("step", "seconds", "progress", "stage", "scene")]
    values = processes.mean([figures.get(name, 0.0) for name in names])
    counts = processes.mean([float(name in figures) for name in names])
    return {name: v / n for name, v, n in zip(names, values, counts, strict=True) if n}


def _tell(name: str, step: int, skipped: Counter[str]) -> None:
    if skipped[name] == 1:
        console.print(f"{name}: the loss is not finite at step {step}; the step is left out")


def _statistics(network: nn.Module | None) -> list[Tensor]:
    """Copies of the network's running statistics, which a step changes even where it is left out."""
    return [] if network is None else [buffer.clone() for buffer in network.buffers()]


def _restore(network: nn.Module | None, statistics: list[Tensor]) -> None:
    if network is not None:
        for buffer, before in zip(network.buffers(), statistics, strict=True):
            buffer.copy_(before)


def _photograph(member: Member, example: Example, generator: torch.Generator) -> Tensor:
    """What the discriminator takes for true beside a render: its photograph, or some one's, [1, 3, H, W]."""
    image, mask = example.image, example.mask
    if image is None:
        i = int(torch.randint(len(member.training), (), generator=generator))
        image, mask = member.training.photograph(i)
    image = image.to(member.config.device) / 255
    return (image if mask is None else image * mask.to(image.device))[None]


def render(renderer: Renderer, stage: Stage, example: Example) -> Tensor:
    """What the stage trains: the whole model, or the colour on the mesh."""
    if stage.network:
        image: Tensor = renderer(example.sight, example.camera)
        return image
    assert isinstance(example.sight, list)  # photographs are gathered for a network alone
    return renderer.colour(example.sight, example.camera)


def losses(
    image: Tensor,
    stage: Stage,
    perceptual: PerceptualTerm | None,
    adversary: Adversary | None,
    example: Example,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """The stage's loss and its terms; an artificial view has the adversarial one alone."""
    terms = {"loss": image.new_zeros(())}
    if example.exposure is not None:
        image = example.exposure.to(image.device).apply(image[0])[None]
    if example.image is not None:
        target = (example.image.to(image.device) / 255)[None]
        mask = None
        if example.mask is not None:
            mask = example.mask.to(image.device)[None, None].float()
            # Features near the mask's border also see pixels beyond it: both show the same black there.
            image, target = image * mask, target * mask
        terms["l1"] = l1(image, target, mask)
        terms["loss"] = stage.l1 * terms["l1"]
        if stage.perceptual and perceptual is not None:
            wanted = perceptual.of_target(example.name, target)
            terms["perceptual"] = perceptual.loss.distance(perceptual.loss.features(image), wanted, mask)
            terms["loss"] = terms["loss"] + stage.perceptual * terms["perceptual"]
    if stage.adversarial and adversary is not None:
        terms["adversarial"] = adversary.term(image, generator)
        terms["loss"] = terms["loss"] + stage.adversarial * terms["adversarial"]
    return terms


@torch.no_grad()
def _validate(renderer: Renderer, views: Views, stage: Stage) -> float:
    """Mean PSNR over the training views kept aside, dB."""
    renderer.eval()
    total = 0.0
    for i in range(len(views)):
        example = views.frame(i)
        assert example.image is not None
        image = render(renderer, stage, example).cpu()
        if example.exposure is not None:
            image = example.exposure.apply(image)
        image = image.clamp(0, 1)
        error = (image - example.image / 255) ** 2
        if example.mask is not None:
            error = error * example.mask
        total += -10 * float(torch.log10(error.mean().clamp_min(1e-10)))
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
