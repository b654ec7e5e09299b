"""nmbg eval."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from nmbg.cli.options import FOLDER, VariadicOption, device_option, threads_option, weights_option
from nmbg.evaluation import LPIPS_NETS, METRICS, SPLITS

if TYPE_CHECKING:
    from nmbg.scene import Split


@click.command(
    epilog="\b\nExample:\n  nmbg eval out/room-run --metrics psnr ssim lpips --lpips-net vgg --weights DIR"
)
@click.argument("run", type=FOLDER)
@click.option(
    "--metrics",
    cls=VariadicOption,
    type=click.Choice(METRICS),
    default=("psnr", "ssim"),
    show_default=True,
    help="ssim_svs is the setting of the FVS, SVS and NMBG papers.",
)
@click.option(
    "--lpips-net", type=click.Choice(LPIPS_NETS), default="alex", show_default=True, help="Network of LPIPS."
)
@click.option("--split", type=click.Choice(SPLITS), default="test", show_default=True, help="Which views.")
@weights_option
@device_option
@threads_option
def command(
    run: Path,
    metrics: tuple[str, ...],
    lpips_net: str,
    split: Split,
    weights: Path | None,
    device: str,
) -> None:
    """Render the held-out views of RUN and measure them.

    Writes metrics.json, sheet.png and renders/ into RUN; with --split train, the same names with -train.
    """
    from nmbg.evaluation.evaluate import evaluate
    from nmbg.evaluation.tables import metrics_table

    report = evaluate(run, metrics, lpips_net, weights, split, device)
    Console().print(metrics_table(report))
