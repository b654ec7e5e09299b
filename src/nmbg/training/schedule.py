"""What each step of training looks at: a function of seed and step alone, which a resumed run repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

# Steps that stay with one scene, where there are several: then it may be loaded for them.
BLOCK = 8


@dataclass(frozen=True)
class Turn:
    """One step.

    Args:
        scene: index of the scene.
        view: index of the training view, or None for an artificial view, which has no photograph.
    """

    scene: int
    view: int | None


class Schedule:
    """Passes over the training views of the scenes, each view once, with artificial views between them.

    Args:
        counts: training views of each of the scenes that this process trains.
        artificial: share of the steps that look at artificial views, in [0, 1).
        seed: of the run.
        length: least number of steps of a pass: a process with fewer begins its own pass again.
    """

    def __init__(self, counts: Sequence[int], artificial: float, seed: int, length: int = 0) -> None:
        self.counts, self.seed = tuple(counts), seed
        self._extra = [extra_steps(count, artificial) for count in counts]
        self.length = max(length, sum(self.counts) + sum(self._extra))
        self._pass: tuple[int, list[Turn]] | None = None

    def turn(self, step: int) -> Turn:
        """What a step of the run looks at."""
        number, position = divmod(step, self.length)
        if self._pass is None or self._pass[0] != number:
            self._pass = number, self._draw(number)
        turns = self._pass[1]
        return turns[position % len(turns)]

    def _draw(self, number: int) -> list[Turn]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + number)
        blocks: list[list[Turn]] = []
        for scene, (count, extra) in enumerate(zip(self.counts, self._extra, strict=True)):
            order = torch.randperm(count + extra, generator=generator).tolist()
            turns = [Turn(scene, i if i < count else None) for i in order]
            size = BLOCK if len(self.counts) > 1 else len(turns)
            blocks += [turns[i : i + size] for i in range(0, len(turns), size)]
        shuffled = torch.randperm(len(blocks), generator=generator).tolist()
        return [turn for i in shuffled for turn in blocks[i]]


def extra_steps(count: int, share: float) -> int:
    """Artificial views to `count` training views, so that they hold this share of both."""
    return round(count * share / (1 - share))


def shard(counts: Sequence[int], parts: int) -> list[list[int]]:
    """Deal scenes out to processes, so that each has about as many images: the largest first, to the idlest.

    Args:
        counts: images per scene.
        parts: processes; no more than scenes.

    Returns:
        indices of the scenes of each process, ascending.
    """
    dealt: list[list[int]] = [[] for _ in range(parts)]
    for i in sorted(range(len(counts)), key=lambda i: (-counts[i], i)):
        idlest = min(range(parts), key=lambda part: (sum(counts[j] for j in dealt[part]), part))
        dealt[idlest].append(i)
    return [sorted(part) for part in dealt]
