"""The training loop: what every step does, over one scene or many, in one process or many."""

from __future__ import annotations

import functools
import operator
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
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
from nmbg.training.config import BESIDE_L1, Stage, TrainConfig
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
        several: whether views of different scenes may have the same name.
    """

    network: nn.Module | None
    counts: list[int]
    length: int
    several: bool

    def member(self, scene: int) -> Member:
        """One of the scenes, loaded."""
        ...

    def save(self, progress: Progress, optimisers: dict[str, Any]) -> None:
        """Write a checkpoint: the scenes', then the run's, with what belongs to all of them."""
        ...


@dataclass(frozen=True)
class Attempt:
    """A step up to its loss.

    Args:
        stage: of the training.
        member: the scene that is looked at.
        example: what is looked at.
        image: [1, 3, H, W], the render as it is compared: exposed as the photograph, black outside its mask.
        terms: of the loss; "loss" is what is descended.
        parts: what the stage trains.
        random: source of the step's random numbers.
    """

    stage: Stage
    member: Member
    example: Example
    image: Tensor
    terms: dict[str, Tensor]
    parts: list[Part]
    random: torch.Generator


class Loop:
    """Trains from a state to the end of the budget, or until interrupted.

    Args:
        config: how.
        run: run folder, for the log.
        crew: the scenes of this process.
        perceptual: L_rec, or None.
        adversary: L_GAN, or None.
        state: where training stands.
        optimisers: states of what belongs to all scenes, from a checkpoint.
        clock: of the run.
    """

    def __init__(
        self,
        config: TrainConfig,
        run: Path,
        crew: Crew,
        perceptual: PerceptualTerm | None,
        adversary: Adversary | None,
        state: Progress,
        optimisers: dict[str, Any],
        clock: Clock,
    ) -> None:
        self.config, self.run, self.crew, self.clock = config, run, crew, clock
        self.perceptual, self.adversary = perceptual, adversary
        self.schedule = Schedule(crew.counts, config.artificial_views, config.seed, crew.length)
        self.budget = Budget(config, self.schedule.length, clock)
        self.step, self.stage, self.caution = state.step, state.stage, state.caution
        self.logged = state.step
        if state.length and state.length != self.schedule.length and config.iterations is None:
            # Other processes: the same share of the passes is over.
            self.step = round(state.step * self.schedule.length / state.length)
        self.skipped, self.in_a_row = Counter(state.skipped), 0
        self._saved = clock.seconds
        self._network: list[Part] | None = None  # of the stage
        self._state_of_network = optimisers.get("network")

    def fit(self) -> None:
        """Train.

        Raises:
            NmbgError: losses stay without a finite value.
            KeyboardInterrupt: interrupted; a checkpoint was saved.
        """
        (progress,) = processes.largest([self.budget.progress(self.step)])
        stop = False
        with Log(self.run, self.logged) as log, _interruptible() as interrupted, progress_bar() as bar:
            task = bar.add_task(f"training {self.config.preset}", total=100)
            while progress < 1 and not stop:
                before, (index, done) = progress, self.budget.stage(progress)
                attempt = self._attempt(index)
                with processes.others_may_end():
                    finite, sound = differentiate(attempt.terms["loss"], attempt.parts)
                # Clocks differ: what hangs on them is agreed on, too.
                overdue = self.clock.seconds - self._saved > SAVE_EVERY
                facts = (not finite, bool(interrupted), overdue, self.budget.progress(self.step + 1))
                bad, stop_, due, progress = processes.largest(facts)
                stop = bool(stop_)
                self.step += 1
                attempt.member.steps += 1
                if bad:
                    self._leave_out(attempt, sound if processes.size() > 1 else finite)
                else:
                    self._descend(attempt, done)
                if not bad and (int(REPORTS * progress) > int(REPORTS * before) or progress >= 1):
                    self._report(log, progress, attempt)
                bar.update(task, completed=100 * progress)
                if due and not stop and progress < 1:
                    self.save()
        if self._network is not None:
            self.save()
        for name, times in self.skipped.items():
            console.print(f"{name}: {times} steps were left out, because the loss was not finite")
        if stop:
            again = f"nmbg train --resume --output {self.run}"
            console.print(f"interrupted at step {self.step}; go on with: {again}")
            raise KeyboardInterrupt

    def save(self) -> None:
        """Write a checkpoint."""
        states: dict[str, Any] = {"network": [optimiser.state_dict() for optimiser, _ in self._network or []]}
        if self.adversary is not None:
            states["adversary"] = self.adversary.state_dict()
        self._saved = self.clock.seconds
        # Each process knows what it left out itself.
        self.skipped = functools.reduce(operator.or_, processes.gathered(self.skipped))
        reached = Progress(
            self.step, self.schedule.length, self.clock.seconds, self.stage, self.caution, dict(self.skipped)
        )
        self.crew.save(reached, states)

    def _attempt(self, index: int) -> Attempt:
        """Render what the step looks at, in a stage (its index), and compare."""
        stage = self.config.stages[index]
        if self._network is None or index != self.stage:
            self._network = network_part(self.crew.network, stage)
            if index == self.stage and self._state_of_network is not None:
                for (optimiser, _), state in zip(self._network, self._state_of_network, strict=True):
                    optimiser.load_state_dict(state)
            self.stage, self._state_of_network = index, None
        turn = self.schedule.turn(self.step)
        member = self.crew.member(turn.scene)
        member.renderer.train()
        example = member.example(turn.view, self.step)
        if self.crew.several:
            example = replace(example, name=f"{member.folder.name}/{example.name}")
        random = torch.Generator().manual_seed(self.config.seed * 1_000_003 + self.step + 1)
        with torch.autocast(self.config.device, torch.bfloat16, enabled=self.config.bf16):
            image = as_photographed(render(member.renderer, stage, example)[None], example)
            terms = losses(image, stage, self.perceptual, self.adversary, example, random)
        parts = [*self._network, *member.parts(index)]
        return Attempt(stage, member, example, image, terms, parts, random)

    def _descend(self, attempt: Attempt, done: float) -> None:
        """Step along the gradients; then the discriminator learns from the same render."""
        self.in_a_row = 0
        descend(attempt.parts, self.caution * ((1 - done) if attempt.stage.decay else 1.0))
        if self.adversary is not None and attempt.stage.adversarial:
            photograph = _photograph(attempt)
            with processes.others_may_end():
                loss = self.adversary.learn(attempt.image, photograph, attempt.random)
            attempt.terms["discriminator"] = loss

    def _leave_out(self, attempt: Attempt, sound: bool) -> None:
        """Let a step not have been; `sound` where another process is the reason."""
        name = attempt.example.name
        self.in_a_row += 1
        if not sound:
            self.skipped[name] += 1
            if self.skipped[name] == 1:
                console.print(f"{name}: the loss is not finite at step {self.step}; the step is left out")
        if self.in_a_row % PATIENCE == 0:
            self.caution *= CAUTION
        if self.in_a_row > HOPELESS:
            raise NmbgError(
                f"{name}: {self.in_a_row} steps in a row without a finite loss; the last checkpoint is "
                "sound: look at the photographs named above, or train anew"
            )

    def _report(self, log: Log, progress: float, attempt: Attempt) -> None:
        """Write a row of figures: means over the processes."""
        stage, member = attempt.stage, attempt.member
        figures = {name: value.item() for name, value in attempt.terms.items()}
        if "adversarial" in figures:
            weighted = _lambda(stage, self.perceptual) * figures["adversarial"]
            figures["adversarial_share"] = weighted / figures["loss"]
        if len(member.validation):
            figures["validation_psnr"] = _validate(member.renderer, member.validation, stage)
        known = {"seconds": self.clock.seconds, "progress": progress, "stage": self.stage}
        log.write(self.step, **known, scene=member.folder.name, **_mean(figures))


def _mean(figures: dict[str, float]) -> dict[str, float]:
    """Figures as means over the processes; what only some of them have, of these alone."""
    names = [name for name in COLUMNS if name not in ("step", "seconds", "progress", "stage", "scene")]
    values = processes.mean([figures.get(name, 0.0) for name in names])
    counts = processes.mean([float(name in figures) for name in names])
    return {name: v / n for name, v, n in zip(names, values, counts, strict=True) if n}


def _photograph(attempt: Attempt) -> Tensor:
    """What the discriminator takes for true beside a render: its photograph, or some one's, [1, 3, H, W]."""
    image, mask, member = attempt.example.image, attempt.example.mask, attempt.member
    if image is None:
        image, mask = member.photograph(attempt.random)
    image = image.to(member.config.device) / 255
    return (image if mask is None else image * mask.to(image.device))[None]


def render(renderer: Renderer, stage: Stage, example: Example) -> Tensor:
    """What the stage trains: the whole model, or the colour on the mesh."""
    if stage.network:
        image: Tensor = renderer(example.sight, example.camera)
        return image
    assert isinstance(example.sight, list)  # photographs are gathered for a network alone
    return renderer.colour(example.sight, example.camera)


def as_photographed(image: Tensor, example: Example) -> Tensor:
    """A render [1, 3, H, W] as its photograph shows what it shows: as exposed, and black outside the mask."""
    if example.exposure is not None:
        image = example.exposure.to(image.device).apply(image[0])[None]
    return image if example.mask is None else image * example.mask.to(image.device)


def losses(
    image: Tensor,
    stage: Stage,
    perceptual: PerceptualTerm | None,
    adversary: Adversary | None,
    example: Example,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """The stage's loss and its terms of a render as photographed; an artificial view has L_GAN alone."""
    terms = {"loss": image.new_zeros(())}
    if example.image is not None:
        target = (example.image.to(image.device) / 255)[None]
        mask = None
        if example.mask is not None:
            mask = example.mask.to(image.device)[None, None].float()
            # Features near the mask's border also see pixels beyond it: both show the same black there.
            target = target * mask
        terms["l1"] = l1(image, target, mask)
        terms["loss"] = stage.l1 * terms["l1"]
        if stage.perceptual and perceptual is not None:
            wanted = perceptual.of_target(example.name, target)
            terms["perceptual"] = perceptual.loss.distance(perceptual.loss.features(image), wanted, mask)
            terms["loss"] = terms["loss"] + stage.perceptual * terms["perceptual"]
    if stage.adversarial and adversary is not None:
        terms["adversarial"] = adversary.term(image, generator)
        terms["loss"] = terms["loss"] + _lambda(stage, perceptual) * terms["adversarial"]
    return terms


def _lambda(stage: Stage, perceptual: PerceptualTerm | None) -> float:
    """Weight of L_GAN, in units of the size of what it stands beside."""
    beside = perceptual if stage.perceptual else None
    return stage.adversarial * (BESIDE_L1 if beside is None else beside.loss.scale)


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
