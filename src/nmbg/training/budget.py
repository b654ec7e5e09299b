"""Iterations, epochs or minutes: how far training is, and which stage that means."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from nmbg.training.config import Stage, TrainConfig


@dataclass
class Clock:
    """Seconds spent on a run, over all its sessions."""

    before: float = 0.0

    def __post_init__(self) -> None:
        self._start = time.monotonic()

    @property
    def seconds(self) -> float:
        """Seconds since the run began, pauses not counted."""
        return self.before + time.monotonic() - self._start


class Budget:
    """How much of a run is over.

    A budget in minutes follows the clock, so that every stage and its decay end in time on any machine;
    iterations and epochs count steps, and then the same seed gives the same run.

    Args:
        config: the run; without any of the three budgets the run is over at once.
        n_steps: of a pass over the training views, one epoch.
        clock: of the run.
    """

    def __init__(self, config: TrainConfig, n_steps: int, clock: Clock) -> None:
        self.clock = clock
        self.seconds = None if config.minutes is None else 60 * config.minutes
        self.steps = config.iterations if config.epochs is None else config.epochs * n_steps
        self.enough = None if config.passes is None else config.passes * n_steps
        self._ends = _stage_ends(config.stages)

    def progress(self, step: int) -> float:
        """Share of the budget that is spent after `step` steps, in [0, 1]."""
        if self.seconds is not None:
            steps = step / self.enough if self.enough else 0.0
            return min(1.0, max(steps, self.clock.seconds / self.seconds))
        return min(1.0, step / self.steps) if self.steps else 1.0

    def stage(self, progress: float) -> tuple[int, float]:
        """Index of the stage at `progress` < 1, and the share of that stage which is over."""
        index = next(i for i, end in enumerate(self._ends) if progress < end)
        begin = self._ends[index - 1] if index else 0.0
        return index, (progress - begin) / (self._ends[index] - begin)


def _stage_ends(stages: Sequence[Stage]) -> list[float]:
    total = sum(stage.share for stage in stages)
    ends = [sum(stage.share for stage in stages[: i + 1]) / total for i in range(len(stages))]
    return [*ends[:-1], 1.0] if ends else []
