"""`nmbg preprocess SOURCE SCENE`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click
from rich.console import Console
from rich.table import Table

from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene


@click.command(epilog="Example: nmbg preprocess photos/dense out/room --max-size 800")
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--images", type=click.Path(path_type=Path), help="Folder of the photographs.  [default: found]"
)
@click.option(
    "--mesh", type=click.Path(path_type=Path), help="Surface mesh.  [default: found by its usual names]"
)
@click.option("--masks", type=click.Path(path_type=Path), help="Folder of masks: bright pixels count.")
@click.option(
    "--max-size", type=click.IntRange(min=16), help="Longest image side, pixels.  [default: as it is]"
)
@click.option(
    "--test-every",
    type=click.IntRange(min=0),
    default=8,
    show_default=True,
    help="Hold out every n-th view; 0: none.",
)
@click.option(
    "--split", type=click.Path(path_type=Path), help="File of held-out views; replaces --test-every."
)
@click.option(
    "--layers", type=click.Choice(["1", "2", "auto"]), default="auto", show_default=True, help="Depth layers."
)
@click.option(
    "--background",
    type=click.Choice(["closed", "shell", "none", "auto"]),
    default="auto",
    show_default=True,
    help="What stands behind the mesh: closed holes and a far shell, the shell alone, nothing.",
)
@click.option(
    "--skip-missing", is_flag=True, help="Go on without images that the model names but the folder lacks."
)
@click.option("--overwrite", is_flag=True, help="Replace SCENE when it exists.")
def command(
    source: Path,
    scene: Path,
    images: Path | None,
    mesh: Path | None,
    masks: Path | None,
    max_size: int | None,
    test_every: int,
    split: Path | None,
    layers: Literal["1", "2", "auto"],
    background: Literal["closed", "shell", "none", "auto"],
    skip_missing: bool,
    overwrite: bool,
) -> None:
    """Make a scene folder SCENE from the capture in SOURCE (a COLMAP workspace)."""
    options = PreprocessOptions(
        images, mesh, masks, max_size, test_every, split, layers, background, skip_missing
    )
    print_summary(preprocess(source, scene, options, overwrite))


def print_summary(scene: Scene) -> None:
    """Print what preprocessing found, on standard output."""
    found = scene.summary
    images, mesh, coverage = found["images"], found["mesh"], found["coverage"]
    table = Table(title=f"scene {scene.folder}", title_justify="left", show_header=False, box=None)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("source", found["source"])
    table.add_row("images", f"{images['registered']} registered of {images['found']} in {images['folder']}")
    for kind in ("unregistered", "absent"):
        if images[kind]:
            table.add_row(f"  {kind}", _shortened(images[kind]))
    table.add_row(
        "  split", f"{images['train']} training, {images['test']} held out; {_size(images['size'])}"
    )
    table.add_row("mesh", f"{mesh['vertices']:,} vertices, {mesh['faces']:,} faces from {mesh['file']}")
    for part in ("mesh", "patches", "shell", "together"):
        least, mean = coverage[part]["min"], coverage[part]["mean"]
        table.add_row(
            "covered" if part == "mesh" else "", f"{part}: {mean:.1%} of a view's pixels (least {least:.1%})"
        )
    table.add_row("background", f"{found['background']['chosen']}: {found['background']['why']}")
    closing, shell = found["closing"], found["shell"]
    if closing["faces"]:
        table.add_row(
            "  patches",
            f"{closing['vertices']:,} vertices, {closing['faces']:,} faces; training pixels without near "
            f"geometry {closing['open_before']:.2%} → {closing['open_after']:.2%}",
        )
    if shell["faces"]:
        table.add_row("  shell", f"{shell['vertices']:,} vertices, {shell['faces']:,} faces")
    table.add_row("layers", f"{found['layers']['chosen']}: {found['layers']['why']}")
    Console().print(table)


def _shortened(names: list[str], most: int = 8) -> str:
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + rest


def _size(size: list[int]) -> str:
    return f"{size[0]}×{size[1]} pixels"
