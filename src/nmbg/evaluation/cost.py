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
    return {
        "train_seconds": load_progress(_checkpoint(run)).seconds,
        "megabytes": sum(run_bytes(run).values()) / 1e6,
    }


def run_bytes(run: Path) -> dict[str, int]:
    """What rendering needs of a run folder, by part, bytes.

    Raises:
        NmbgError: it has no checkpoint.
    """
    scene, checkpoint = run / SCENE, _checkpoint(run)
    parts = {
        "photographs": [file for kind in ("images", "masks") for file in (scene / kind).rglob("*")],
        "geometry": list(scene.glob("*")),
        "descriptors": list(checkpoint.glob("descriptors.*")),
        "network": list(checkpoint.glob("network.*")),
    }
    return {
        name: sum(file.stat().st_size for file in files if file.is_file()) for name, files in parts.items()
    }


def _checkpoint(run: Path) -> Path:
    found = latest_checkpoint(run)
    if found is None:
        raise NmbgError(f"{run}: no checkpoint yet; continue it with nmbg train --resume")
    return found
