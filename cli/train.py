"""nmbg train."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

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
from nmbg.training.config import PRESETS, Start, TrainConfig, without_perceptual

# Of a preset that says nothing itself.
MINUTES = 15.0


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


ZOOM = click.FloatRange(min=0, min_open=True)


@click.command(
    epilog="\b\nExamples:\n  nmbg train out/room --output out/room-run --minutes 5\n"
    "  nmbg train out/room out/garden --preset paper --output out/both --weights DIR\n"
    "  nmbg train out/hall --preset paper --init out/both --output out/hall-run --weights DIR\n"
    "  torchrun --nproc-per-node 2 -m nmbg train out/room out/garden --preset paper --output out/both"
)
@click.argument("scenes", type=FOLDER, nargs=-1, metavar="SCENE...")
@click.option("--output", type=NEW_FOLDER, required=True, help="Run folder to write.")
@click.option(
    "--preset", type=click.Choice(list(PRESETS)), default="nmbg", show_default=True, help="What to train."
)
@click.option(
    "--minutes",
    type=click.FloatRange(min=0, min_open=True),
    help="Budget in minutes of wall-clock time.  [default: 15; but preset paper 100 epochs, and several "
    "scenes 15 epochs]",
)
@click.option("--iterations", type=click.IntRange(min=0), help="Budget in steps.")
@click.option("--epochs", type=click.IntRange(min=0), help="Budget in passes over the training views.")
@click.option("--perceptual", help='Layers of L_rec: "vgg19", "vgg19:relu1_2,relu2_2,relu3_1" or "none".')
@weights_option
@click.option(
    "--adversarial", type=click.FloatRange(min=0), help="Weight λ of the adversarial loss, 0 for none."
)
@click.option(
    "--artificial-views",
    type=click.FloatRange(min=0, max=1, max_open=True),
    help="Share of the steps that look at views without a photograph, for the adversarial loss alone.",
)
@click.option(
    "--init", type=FOLDER, metavar="RUN", help="Begin with the network of another run, of one scene or many."
)
@click.option(
    "--zoom",
    type=(ZOOM, ZOOM),
    metavar="LEAST LARGEST",
    help="Random zoom of training windows, beside the photographs' own pixels.",
)
@click.option(
    "--window", type=click.FloatRange(min=0, max=1, min_open=True), help="Training windows' share of a side."
)
@click.option(
    "--start",
    type=click.Choice(get_args(Start)),
    help="What descriptors start at: zeros, the mesh's mean colours, or directional colours fitted to the "
    "photographs; for presets that blend no photographs.  [default: paper zeros, mesh fit, others mean]",
)
@click.option(
    "--validation-views",
    type=click.IntRange(min=0),
    help="Training views kept aside for progress figures.  [default: 0]",
)
@click.option(
    "--exposure/--no-exposure",
    default=None,
    help="Tell exposures, where they differ, apart from what is photographed; for presets that blend no "
    "photographs.  [default: in npbg to adversarial]",
)
@click.option(
    "--inspect/--no-inspect",
    default=None,
    help="Leave out photographs that are black, of something else or wildly misplaced.  [default: inspect]",
)
@click.option(
    "--refine",
    type=click.Choice(["none", "geometry", "poses", "geometry,poses"]),
    help="Move the surface, or cameras whose poses are rough, to where the photographs agree.  [default: "
    "geometry for nmbg]",
)
@click.option(
    "--photos",
    type=PhotoCount(),
    help="Photographs to keep: a number, auto (what the scene needs) or all.  [default: all]",
)
@click.option(
    "--capacity",
    type=click.Choice(["auto", "full"]),
    default="full",
    show_default=True,
    help="Size of the model: the preset's, or what left-out training views need.",
)
@click.option(
    "--fps", type=click.FloatRange(min=0, min_open=True), help="With --capacity auto: frames a second wished."
)
@click.option(
    "--megabytes",
    type=click.FloatRange(min=0, min_open=True),
    help="With --capacity auto: the most that photographs may take.",
)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@device_option
@click.option(
    "--bf16/--no-bf16", default=None, help="bfloat16 network and loss  [default: where it is faster here]"
)
@threads_option
@click.option(
    "--cache",
    "cache_gib",
    type=click.FloatRange(min=0),
    help="Memory for what views show, GiB; disk takes the rest.",
)
@overwrite_option
@click.option(
    "--resume", "resuming", is_flag=True, help="Go on with an interrupted run, with its own options."
)
@click.pass_context
def command(
    context: click.Context,
    /,
    scenes: tuple[Path, ...],
    output: Path,
    preset: str,
    weights: Path | None,
    init: Path | None,
    device: str,
    overwrite: bool,
    resuming: bool,
    **options: Any,
) -> None:
    """Train SCENE, a folder that nmbg preprocess wrote.

    Several scenes share one network, and OUTPUT/scenes/NAME is a run folder of each. Under torchrun their
    processes share the scenes out.
    """
    from nmbg.training import processes

    if resuming:
        _refuse_options(context)
        device = _device_of(output, device, context)
    elif not scenes:
        raise NmbgError("no scene given; name a folder that nmbg preprocess wrote")
    with processes.joined(device):
        if resuming:
            written = _resume(output, device, weights)
        else:
            config = _config(preset, device, options, len(scenes), init is not None)
            written = _train(scenes, config, output, weights, overwrite, init)
        if processes.rank() == 0:
            click.echo(written)


def _train(scenes: tuple[Path, ...], config: TrainConfig, output: Path, *options: Any) -> Path:
    from nmbg.scene import Scene
    from nmbg.training import processes
    from nmbg.training.full import train_together
    from nmbg.training.trainer import train

    _keep_apart(output, scenes, options[-1])
    with _memory_named(config):
        if len(scenes) == processes.size() == 1:
            return train(Scene.load(scenes[0]), config, output, *options)
        return train_together(scenes, config, output, *options)


def _keep_apart(output: Path, scenes: tuple[Path, ...], init: Path | None) -> None:
    """Refuse a run that would take the place of what it is made from."""
    place = output.resolve()
    for source in (*scenes, *([init] if init else [])):
        other = source.resolve()
        if place == other or place in other.parents or other in place.parents:
            raise NmbgError(
                f"--output {output}: is, holds or lies in {source}; give the run a place of its own"
            )


def _device_of(output: Path, wished: str, context: click.Context) -> str:
    """Where a run goes on: on the device that it began on, unless told otherwise."""
    import torch

    from nmbg.training import checkpoint

    if context.get_parameter_source("device") is ParameterSource.COMMANDLINE:
        return wished
    device = checkpoint.load_config(output)[1].device
    if device == "cuda" and not torch.cuda.is_available():
        raise NmbgError(
            f"{output}: was trained on CUDA, and torch sees no such device here; add --device cpu"
        )
    return device


def _resume(output: Path, device: str, weights: Path | None) -> Path:
    from nmbg.training import checkpoint, processes
    from nmbg.training.full import resume_together
    from nmbg.training.trainer import resume

    scenes, config = checkpoint.load_config(output)
    with _memory_named(config, resumed=True):
        if len(scenes) == processes.size() == 1:
            return resume(output, weights, device)
        return resume_together(output, weights, device)


@contextmanager
def _memory_named(config: TrainConfig, resumed: bool = False) -> Iterator[None]:
    """Say in one line that memory ran out, and which options need less.

    Raises:
        NmbgError: memory ran out.
    """
    import torch

    try:
        yield
    except (MemoryError, RuntimeError) as error:
        told = (str(error).splitlines() or [""])[0]
        if not isinstance(error, MemoryError | torch.OutOfMemoryError) and "allocate memory" not in told:
            raise
        half = config.cache_gib / 2
        advice = [f"--cache {half:g} holds {half:g} GiB less"] if half else []
        if config.model.widths:
            advice.append(f"--window {config.window / 2:.3g} makes a step a quarter as large")
        advice.append("nmbg preprocess --max-size with half the pixels a side makes everything a quarter")
        if resumed:
            advice = ["a resumed run keeps its options; close other programs, or train anew", *advice]
        raise NmbgError(f"out of memory ({told or 'no more was given'}); {', '.join(advice)}") from error


def _config(preset: str, device: str, options: dict[str, Any], scenes: int, init: bool) -> TrainConfig:
    """The preset with what was asked for."""
    from nmbg.training.full import EPOCHS
    from nmbg.training.left_out import can_leave_out
    from nmbg.training.precision import bf16_is_faster

    given = {name: value for name, value in options.items() if value is not None}
    if given.keys() & {"minutes", "iterations", "epochs"}:
        given = {"minutes": None, "iterations": None, "epochs": None, **given}
    elif scenes > 1:
        given |= {"minutes": None, "iterations": None, "epochs": EPOCHS}
    elif PRESETS[preset].stages and PRESETS[preset].epochs is None:
        given["minutes"] = MINUTES
    if "bf16" not in given and PRESETS[preset].model.widths:
        given["bf16"] = bf16_is_faster(device)
    if given.get("perceptual", "none") != "none" and not any(s.perceptual for s in PRESETS[preset].stages):
        raise NmbgError(f"--perceptual: preset {preset} trains without L_rec; leave it out")
    if given.get("perceptual") == "none":
        given["stages"] = tuple(without_perceptual(stage) for stage in PRESETS[preset].stages)
    if "photos" in given and not PRESETS[preset].model.sources:
        raise NmbgError(f"--photos: preset {preset} blends no photographs; leave it out")
    if given["capacity"] == "auto" and not can_leave_out(PRESETS[preset]):
        raise NmbgError(f"--capacity auto: does not size preset {preset}; use nmbg or photos")
    if given["capacity"] == "auto" and given.get("photos") == "all":
        raise NmbgError("--capacity auto: keeps the photographs that the scene needs, --photos all keeps all")
    if given["capacity"] == "auto" and init:
        raise NmbgError("--capacity auto: --init gives the network its size; leave one of the two out")
    if given["capacity"] == "auto" and scenes > 1:
        raise NmbgError("--capacity auto sizes the model of one scene; train the scenes one by one")
    if given.get("fps") and not PRESETS[preset].model.widths:
        raise NmbgError(f"--fps: preset {preset} has no network that could be smaller; leave it out")
    stages = given.pop("stages", PRESETS[preset].stages)
    if "adversarial" in given:
        if not any(stage.network for stage in stages):
            raise NmbgError(f"--adversarial: preset {preset} trains no network; leave it out")
        weight = given.pop("adversarial")
        stages = tuple(replace(stage, adversarial=weight) if stage.network else stage for stage in stages)
        if not weight:
            given.setdefault("artificial_views", 0.0)
    try:
        return replace(PRESETS[preset], device=device, stages=stages, **given)
    except ValueError as error:
        raise NmbgError(f"{error}; see nmbg train --help") from error


def _refuse_options(context: click.Context) -> None:
    """A resumed run keeps its own options; naming others would change its meaning silently."""
    if context.params["scenes"]:
        raise NmbgError("--resume: a run knows its scenes; name only its --output")
    free = {"output", "resuming", "weights", "threads", "device"}
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name not in free and source is ParameterSource.COMMANDLINE:
            raise NmbgError(
                f"{parameter.opts[0]}: a resumed run keeps its own options; leave it out, or train anew"
            )
