"""Progress bars on standard error, so that standard output stays clean."""

from __future__ import annotations

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

console = Console(stderr=True)


_hidden = False


def hide_bars() -> None:
    """Show no bars from now on: of several processes one shows its own, and all say what they find."""
    global _hidden
    _hidden = True


def progress_bar() -> Progress:
    """A bar with count, elapsed and remaining time; `.track(sequence, description=...)` iterates under it."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=_hidden,
    )
