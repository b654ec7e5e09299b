"""nmbg compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from nmbg.cli.options import FOLDER
from nmbg.errors import NmbgError
from nmbg.evaluation import SPLITS

if TYPE_CHECKING:
    from nmbg.scene import Split


@click.command(
    epilog="Example: nmbg compare out/room-run out/room-npbg splats/test-eval --output out/room.html"
)
@click.argument("results", type=FOLDER, nargs=-1, required=True, metavar="RUN...")
@click.option("--split", type=click.Choice(SPLITS), default="test", show_default=True, help="Which views.")
@click.option(
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    default="compare.html",
    show_default=True,
    help="Page to write.",
)
def command(results: tuple[Path, ...], split: Split, output: Path) -> None:
    """Show evaluated runs, or folders of nmbg eval --renders, side by side."""
    if len(results) < 2:
        raise NmbgError(f"{results[0]}: nothing to compare it with; name two or more runs")
    from nmbg.evaluation.compare import comparison_table, read_all, write_comparison

    found = read_all(results, split)
    write_comparison(output, found)
    Console().print(comparison_table(found))
    click.echo(output)
