"""The table of what was chosen, for config.yaml and for the user to read."""

from __future__ import annotations

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

    def __str__(self) -> str:
        return f"{self.choice}: saves {self.saves}, costs {self.costs}; {self.reason}"


def megabytes(count: float) -> str:
    """A number of bytes in words."""
    return f"{count / 1e6:.2f} MB"
