"""nmbg eval."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from nmbg.cli.options import FOLDER, NEW_FOLDER, VariadicOption, device_option, threads_option, weights_option
from nmbg.errors import NmbgError
from nmbg.evaluation import LPIPS_NETS, METRICS, SPLITS
from nmbg.evaluation.published import TABLES

if TYPE_CHECKING:
    from nmbg.scene import Split

SECONDS = click.FloatRange(min=0)


@click.command(
    epilog="\b\nExamples:\n  nmbg eval out/room-run --metrics psnr ssim lpips --lpips-net vgg --weights DIR\n"
    "  nmbg eval --renders splats/test --scene out/room --label splats --seconds-per-frame 0.01 "
    "--train-seconds 900"
)
@click.argument("run", type=FOLDER, required=False)
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
@click.option(
    "--table",
    type=click.Choice(list(TABLES)),
    help="Published results to show in the report.  [default: found by the scene's name]",
)
@click.option("--renders", type=FOLDER, help="Measure another program's pictures of the views, not a run.")
@click.option("--scene", type=FOLDER, help="With --renders: the scene.")
@click.option("--label", help="With --renders: what to call them.")
@click.option(
    "--index",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help='With --renders: JSON, {"view": "picture"}.  [default: by file names, else by numbers]',
)
@click.option("--seconds-per-frame", type=SECONDS, help="With --renders: as measured elsewhere.")
@click.option("--train-seconds", type=SECONDS, help="With --renders: as measured elsewhere.")
@click.option("--megabytes", type=SECONDS, help="With --renders: size of the trained scene.")
@click.option(
    "--output", type=NEW_FOLDER, help="With --renders: where the results go.  [default: RENDERS-eval]"
)
@weights_option
@device_option
@threads_option
def command(
    run: Path | None,
    metrics: tuple[str, ...],
    lpips_net: str,
    split: Split,
    table: str | None,
    renders: Path | None,
    weights: Path | None,
    device: str,
    **foreign: Any,
) -> None:
    """Render the held-out views of RUN and measure them, or measure what another program rendered.

    Writes report.html, metrics.json, colours.csv, sheet.png and renders/ into RUN; with --split train, the
    same names with -train.
    """
    if (run is None) == (renders is None):
        raise click.UsageError("Missing argument 'RUN' or option '--renders': name one of the two.")
    for name, value in foreign.items():
        if renders is None and value is not None:
            raise NmbgError(
                f"--{name.replace('_', '-')}: is about --renders, which is not given; leave it out"
            )
        if renders is not None and value is None and name in ("scene", "label"):
            raise NmbgError(f"--renders: needs --{name}, see nmbg eval --help")

    from nmbg.evaluation.evaluate import evaluate
    from nmbg.evaluation.foreign import evaluate_renders
    from nmbg.evaluation.tables import metrics_table

    settings = (metrics, lpips_net, weights, split, device, table)
    if renders is None:
        assert run is not None
        report = evaluate(run, *settings)
    else:
        place = renders.resolve()
        output = foreign.pop("output") or place.with_name(f"{place.name}-eval")
        report = evaluate_renders(
            renders, foreign.pop("scene"), foreign.pop("label"), output, *settings, **foreign
        )
    Console().print(metrics_table(report))
