"""The table of what was chosen, for config.yaml and for the user to read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Choice:
    """One choice about the size of a model.

    Args:
        choice: what was chosen.
        saves: what that saves.
        costs: what it costs left-out training views.
        reason: why.
    """

    choice: str
    saves: str
    costs: str
    reason: str

    @property
    def part(self) -> str:
        """Of the model, that it is about."""
        return self.choice.partition(":")[0]

    def __str__(self) -> str:
        return f"{self.choice}: saves {self.saves}, costs {self.costs}; {self.reason}"


def megabytes(count: float) -> str:
    """A number of bytes in words."""
    return f"{count / 1e6:.2f} MB"


def least(enough: Callable[[int], bool], usual: int) -> int:
    """The first of growing sizes that is enough, searched from a usual one; one of them must be."""
    i = usual
    while not enough(i):
        i += 1
    while i > 0 and enough(i - 1):
        i -= 1
    return i
