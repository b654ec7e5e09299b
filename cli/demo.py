"""nmbg demo."""

from __future__ import annotations

import importlib
import json
import shlex
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from nmbg.atomic import atomic_file, refuse_existing
from nmbg.backbones import installed_weights
from nmbg.cli.options import NEW_FOLDER, weights_option
from nmbg.demo.capture import CaptureConfig, make_capture
from nmbg.evaluation.figures import Row, error_map, sheet
from nmbg.evaluation.tables import format_metric
from nmbg.images import Image, read_image, write_image

PRESETS = ("colours", "mesh", "nmbg")
MESH_SHARE = 1 / 8  # of the minutes: the colour mesh is done sooner
LPIPS_NETS = {"alex": "alexnet", "vgg": "vgg16", "squeeze": "squeezenet1_1"}


@click.command(epilog="Example: nmbg demo out/demo")
@click.argument("out", type=NEW_FOLDER)
@click.option(
    "--minutes",
    type=click.FloatRange(min=0, min_open=True),
    default=4.4,
    show_default=True,
    help="Most time to train, all presets together.",
)
@click.option(
    "--views", type=click.IntRange(min=4), default=40, show_default=True, help="Photographs to make."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of scene and training."
)
@weights_option
@click.option("--overwrite", is_flag=True, help="Replace what an earlier demo left in OUT.")
def command(out: Path, minutes: float, views: int, seed: int, weights: Path | None, overwrite: bool) -> None:
    """Generate a small capture in OUT, train it with three presets and show its held-out views.

    Nothing is downloaded. OUT/capture is a COLMAP workspace as any other, with a mesh that is coarser and
    noisier than the surface in its photographs; every command that is run on it is printed.
    """
    if not overwrite:
        refuse_existing(out, overwrite)
    lpips = next((net for net, backbone in LPIPS_NETS.items() if installed_weights(backbone, weights)), None)
    folder = ["--weights", str(weights)] if weights else []
    again = ["--overwrite"] if overwrite else []

    make_capture(out / "capture", CaptureConfig(views=views, seed=seed), overwrite)
    _run("preprocess", str(out / "capture"), str(out / "scene"), *again)
    for preset in PRESETS:
        run = str(out / preset)
        options = ["--preset", preset, "--seed", str(seed), *again]
        if preset != "colours":
            share = MESH_SHARE if preset == "mesh" else 1 - MESH_SHARE
            options += ["--minutes", f"{share * minutes:.4g}"]
        _run("train", str(out / "scene"), "--output", run, *options)
        metrics = ["--metrics", "psnr", "ssim", *(["lpips", "--lpips-net", lpips, *folder] if lpips else [])]
        _run("eval", run, *metrics)

    with atomic_file(out / "sheet.png") as path:
        write_image(path, _sheet(out))
    Console().print(_table(out))
    if lpips is None:
        click.echo(
            "lpips is left out: its pretrained network was not found (nmbg info tells where it is looked for)"
        )
    click.echo(f"held-out views beside the truth: {out / 'sheet.png'}")


def _run(name: str, *words: str) -> None:
    """Run a command of this program as a user would."""
    click.echo(f"$ {shlex.join(['nmbg', name, *words])}")
    called: click.Command = importlib.import_module(f"nmbg.cli.{name}").command
    with called.make_context(f"nmbg {name}", list(words)) as context:
        called.invoke(context)


def _table(out: Path) -> Table:
    """Held-out means, a row per preset."""
    means = {preset: json.loads((out / preset / "metrics.json").read_text())["mean"] for preset in PRESETS}
    table = Table(title="held-out views, mean", title_justify="left")
    table.add_column("preset")
    for metric in means["nmbg"]:
        table.add_column(metric, justify="right")
    for preset, mean in means.items():
        table.add_row(preset, *(format_metric(metric, value) for metric, value in mean.items()))
    return table


def _sheet(out: Path) -> Image:
    """Every held-out view: the truth, the presets, and the error of the last."""
    rows = []
    for path in sorted((out / PRESETS[-1] / "renders").glob("*.target.png")):
        name = path.name.removesuffix(".target.png")
        truth = read_image(path)
        renders = [read_image(out / preset / "renders" / f"{name}.png") for preset in PRESETS]
        rows.append(Row(name, (truth, *renders, error_map(renders[-1], truth))))
    return sheet(rows, ("truth", *PRESETS, f"error of {PRESETS[-1]}"))
