"""Beginning with the network of another run."""

from __future__ import annotations

from pathlib import Path

from torch import nn

from nmbg.errors import NmbgError
from nmbg.training import checkpoint
from nmbg.training.adversary import Adversary
from nmbg.training.config import TrainConfig

# What the weights of a network depend on.
SHAPE = ("layers", "widths", "sources", "features", "faces", "points")


def take_over(
    init: Path, config: TrainConfig, network: nn.Module | None, adversary: Adversary | None
) -> None:
    """Load the network of another run's last checkpoint, and its discriminator where both have one.

    Args:
        init: run folder, of one scene or several.
        config: of the run that begins.
        network: of the run that begins.
        adversary: of the run that begins.

    Raises:
        NmbgError: no such run, or one with another network.
    """
    found = refuse_other_network(init, config)
    checkpoint.load_module(found, "network", network)
    if adversary is not None and (found / checkpoint.OPTIMISERS).exists():  # a compact run has none
        states = checkpoint.load_optimisers(found)
        if "adversary" in states:
            adversary.load_state_dict(states["adversary"])


def refuse_other_network(init: Path, config: TrainConfig) -> Path:
    """The last checkpoint of a run whose network another begins with.

    Args:
        init: run folder, of one scene or several.
        config: of the run that begins.

    Raises:
        NmbgError: no such run, or one with another network.
    """
    _, other = checkpoint.load_config(init)
    found = checkpoint.latest_checkpoint(init)
    if found is None:
        raise NmbgError(f"--init {init}: the run has no checkpoint; train it first")
    if not config.model.widths:
        raise NmbgError(f"--init: preset {config.preset} has no network; leave it out")
    for name in SHAPE:
        mine, theirs = getattr(config.model, name), getattr(other.model, name)
        if mine != theirs:
            raise NmbgError(
                f"--init {init}: its network has {name} {theirs}, preset {config.preset} has {mine}; "
                f"use --preset {other.preset}"
            )
    return found
