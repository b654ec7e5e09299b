"""nmbg render."""

from __future__ import annotations

from pathlib import Path

import click

from nmbg.cli.options import FOLDER, NEW_FOLDER, device_option, overwrite_option, threads_option


@click.command(
    epilog="\b\nExamples:\n  nmbg render out/room-run --output out/room-path\n"
    "  nmbg render out/room-run --views 12 --frames 300 --output out/room.mp4"
)
@click.argument("run", type=FOLDER)
@click.option("--output", type=NEW_FOLDER, required=True, help="Folder for numbered pictures, or NAME.mp4.")
@click.option(
    "--views",
    type=click.IntRange(min=2),
    default=8,
    show_default=True,
    help="Training views that the camera passes through, spread evenly over their names.",
)
@click.option(
    "--frames", type=click.IntRange(min=2), default=120, show_default=True, help="On the whole path."
)
@click.option("--fps", type=click.FloatRange(min=1), default=30.0, show_default=True, help="Of a video.")
@click.option(
    "--max-size",
    type=click.IntRange(min=16),
    help="Longest image side, pixels.  [default: that of the training views]",
)
@overwrite_option
@device_option
@threads_option
def command(
    run: Path,
    output: Path,
    views: int,
    frames: int,
    fps: float,
    max_size: int | None,
    overwrite: bool,
    device: str,
) -> None:
    """Render RUN, a folder that nmbg train wrote, along a smooth path through its training views."""
    from nmbg.film import film
    from nmbg.paths import through
    from nmbg.scene import evenly
    from nmbg.training.checkpoint import load_run
    from nmbg.training.run_views import load_cameras

    renderer = load_run(run, device).renderer
    path = through(evenly(load_cameras(run), views), frames)
    if max_size is not None:
        path = [camera.within(max_size) for camera in path]
    film(renderer, path, output, fps, overwrite)
    click.echo(output)
