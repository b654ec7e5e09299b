"""What a run cost: time to train, and what it takes on disk to be rendered."""

from __future__ import annotations

from pathlib import Path
from typing import TypedDict

from nmbg.errors import NmbgError
from nmbg.training.checkpoint import SCENE, latest_checkpoint, load_progress


class Cost(TypedDict):
    """Parts of a Report.

    Args:
        train_seconds: wall-clock time from reading the scene to the last checkpoint.
        megabytes: geometry, photographs, descriptors and network, 10⁶ bytes; not the optimisers' state.
    """

    train_seconds: float
    megabytes: float


def run_cost(run: Path) -> Cost:
    """The cost of a run.

    Args:
        run: run folder of one scene.

    Raises:
        NmbgError: it has no checkpoint, or a damaged one.
    """
    checkpoint = latest_checkpoint(run)
    if checkpoint is None:
        raise NmbgError(f"{run}: no checkpoint yet; continue it with nmbg train --resume")
    files = [*(run / SCENE).rglob("*"), *checkpoint.glob("*.safetensors")]
    return {
        "train_seconds": load_progress(checkpoint).seconds,
        "megabytes": sum(file.stat().st_size for file in files if file.is_file()) / 1e6,
    }
