"""Options that several benchmarks share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

scenes_argument: Decorator = click.argument(
    "scenes", type=click.Path(path_type=Path), nargs=-1, required=True
)
weights_option: Decorator = click.option(
    "--weights", type=click.Path(path_type=Path), required=True, help="Folder of pretrained weights."
)


def output_option(holds: str) -> Decorator:
    """Where results go; `holds` says which."""
    return click.option(
        "--output", type=click.Path(path_type=Path), required=True, help=f"Folder for {holds}."
    )
