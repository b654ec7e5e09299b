"""nmbg export."""

from __future__ import annotations

from pathlib import Path

import click

from nmbg.cli.options import FOLDER, NEW_FOLDER, overwrite_option
from nmbg.errors import NmbgError


@click.command(epilog="Example: nmbg export out/room-run --compact --output out/room-small")
@click.argument("run", type=FOLDER)
@click.option("--output", type=NEW_FOLDER, required=True, help="Folder to write.")
@click.option("--compact", is_flag=True, help="A run folder without training state, in fewer bits.")
@overwrite_option
def command(run: Path, output: Path, compact: bool, overwrite: bool) -> None:
    """Write RUN, a folder that nmbg train wrote, in another form."""
    from nmbg.capacity.export import export_compact

    if not compact:
        raise NmbgError("nmbg export: say what to write: --compact")
    click.echo(export_compact(run, output, overwrite))
