"""nmbg train."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
from click.core import ParameterSource

from nmbg.cli.options import (
    FOLDER,
    NEW_FOLDER,
    device_option,
    overwrite_option,
    threads_option,
    weights_option,
)
from nmbg.errors import NmbgError
from nmbg.training.config import PRESETS


class PhotoCount(click.ParamType[int | str]):
    """A positive number, auto or all."""

    name = "N|auto|all"

    def convert(
        self, value: str | int, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | int:
        """The number, or the word."""
        if value in ("auto", "all"):
            return value
        if not str(value).isdigit():
            self.fail(f"{value!r} is no number, nor auto or all", param, ctx)
        if int(value) == 0:
            raise NmbgError("--photos 0: nothing would be left to blend; use --preset mesh")
        return int(value)


@click.command(epilog="\b\nExample:\n  nmbg train out/room --output out/room-run --minutes 15 --weights DIR")
@click.argument("scene", type=FOLDER, required=False)
@click.option("--output", type=NEW_FOLDER, required=True, help="Run folder to write.")
@click.option(
    "--preset", type=click.Choice(list(PRESETS)), default="nmbg", show_default=True, help="What to train."
)
@click.option(
    "--minutes", type=click.FloatRange(min=0, min_open=True), help="Budget in minutes of wall-clock time."
)
@click.option("--iterations", type=click.IntRange(min=0), help="Budget in steps.")
@click.option("--epochs", type=click.IntRange(min=0), help="Budget in passes over the training views.")
@click.option("--perceptual", help='Layers of L_rec: "vgg19", "vgg19:relu1_2,relu2_2,relu3_1" or "none".')
@weights_option
@click.option("--zoom", type=click.FloatRange(min=1), help="Largest random zoom of training windows.")
@click.option(
    "--window", type=click.FloatRange(min=0, max=1, min_open=True), help="Training windows' share of a side."
)
@click.option(
    "--validation-views", type=click.IntRange(min=0), help="Training views kept aside for progress figures."
)
@click.option(
    "--refine",
    type=click.Choice(["geometry", "none"]),
    help="Move the surface to where the photographs agree  [default: geometry for nmbg]",
)
@click.option(
    "--photos",
    type=PhotoCount(),
    help="Photographs to keep: a number, auto (what the scene needs) or all.  [default: all]",
)
@click.option("--seed", type=int, default=0, show_default=True)
@device_option
@click.option(
    "--bf16/--no-bf16", default=None, help="bfloat16 network and loss  [default: where the machine has it]"
)
@threads_option
@click.option("--cache", "cache_gib", type=click.FloatRange(min=0), help="Memory for fragments, GiB.")
@overwrite_option
@click.option(
    "--resume", "resuming", is_flag=True, help="Go on with an interrupted run, with its own options."
)
@click.pass_context
def command(
    context: click.Context,
    /,
    scene: Path | None,
    output: Path,
    preset: str,
    weights: Path | None,
    device: str,
    overwrite: bool,
    resuming: bool,
    **options: object,
) -> None:
    """Train SCENE, a folder that nmbg preprocess wrote."""
    from nmbg.scene import Scene
    from nmbg.training.trainer import resume, train

    if resuming:
        _refuse_options(context)
        click.echo(resume(output, weights))
        return
    if scene is None:
        raise NmbgError("no scene given; name a folder that nmbg preprocess wrote")
    given = {name: value for name, value in options.items() if value is not None}
    if given.keys() & {"minutes", "iterations", "epochs"}:
        given = {"minutes": None, "iterations": None, "epochs": None, **given}
    given.setdefault("bf16", _has_bf16(device))
    if given.get("perceptual", "none") != "none" and not any(s.perceptual for s in PRESETS[preset].stages):
        raise NmbgError(f"--perceptual: preset {preset} trains without L_rec; leave it out")
    if "photos" in given and not PRESETS[preset].model.sources:
        raise NmbgError(f"--photos: preset {preset} blends no photographs; leave it out")
    try:
        config = replace(PRESETS[preset], device=device, **given)  # type: ignore[arg-type]
    except ValueError as error:
        raise NmbgError(f"{error}; see nmbg train --help") from error
    click.echo(train(Scene.load(scene), config, output, weights, overwrite))


def _refuse_options(context: click.Context) -> None:
    """A resumed run keeps its own options; naming others would change its meaning silently."""
    free = {"output", "resuming", "weights", "threads", "scene"}
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name not in free and source is ParameterSource.COMMANDLINE:
            raise NmbgError(
                f"{parameter.opts[0]}: a resumed run keeps its own options; leave it out, or train anew"
            )


def _has_bf16(device: str) -> bool:
    """Whether bfloat16 convolutions are faster than float32 ones: only where the hardware multiplies them."""
    import torch

    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    # AVX-512's own bfloat16 instructions take twice as long as float32 ones: docs/performance.md.
    return bool(torch.cpu._is_amx_tile_supported())
