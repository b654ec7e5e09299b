"""Accuracy against what it costs: presets and sizes of model, on charts with their Pareto fronts.

Example:
    python benchmarks/speed_accuracy.py out/fox --weights DIR --output out/speed

Every preset is trained for 1, 4 and 15 minutes, every variant of size for 4; what needs no training is
measured once, and mesh and photos-mesh end after ten passes. PSNR, SSIM and LPIPS of the held-out views are
charted against minutes of training, milliseconds a frame and megabytes of the trained scene. Finished points
are kept: run it again and it goes on where it stopped. Another program's pictures enter by `--foreign`, a
folder that `nmbg eval --renders` wrote with the metrics psnr, ssim and lpips (squeeze).

The full form trains for 3 hours 20 minutes a scene; preparing and judging the runs comes on top. `--quick`
trains each point for 15 seconds.
"""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from nearest import render_nearest
from options import output_option, weights_option
from record import command, provenance, write
from smaller import smaller_scene
from sweep import Job, Sweep, trained_for

from nmbg.atomic import atomic_file
from nmbg.evaluation.charts import COLOURS, Axis, Series, chart, figure
from nmbg.evaluation.foreign import evaluate_renders
from nmbg.evaluation.pareto import pareto_front
from nmbg.evaluation.results import Report, read_results
from nmbg.scene import Scene
from nmbg.training.config import PRESETS

QUICK = 0.25  # minutes
METRICS = {"psnr": ("PSNR, dB", True), "ssim": ("SSIM", True), "lpips_squeeze": ("LPIPS (squeeze)", False)}
COSTS = {
    "minutes": "minutes of training",
    "milliseconds": "ms per frame",
    "megabytes": "MB of the trained scene",
}
FRONT = "Pareto front"
CLOSE = 3.0  # dB below the best PSNR: drawn once more, larger
SIZE = (440, 300)  # of a chart, pixels


@dataclass(frozen=True)
class Variant:
    """A preset with other sizes.

    Args:
        preset: the preset.
        model: fields of its ModelConfig.
        scene: how the scene is made smaller (`smaller_scene`).
        bf16: network in bfloat16 or not; None for what is faster.
    """

    preset: str
    model: dict[str, Any] = field(default_factory=dict)
    scene: dict[str, float] = field(default_factory=dict)
    bf16: bool | None = None


VARIANTS = {
    **{preset: Variant(preset) for preset in PRESETS},
    "mesh-1-sample": Variant("mesh", {"supersample": 1}),
    "nmbg-narrow": Variant("nmbg", {"widths": (16, 16)}),
    "nmbg-wide": Variant("nmbg", {"widths": (64, 64)}),
    "nmbg-1-layer": Variant("nmbg", {"widths": (32,)}),
    "nmbg-3-layers": Variant("nmbg", {"widths": (32, 32, 32)}),
    "nmbg-degree-0": Variant("nmbg", {"degree": 0}),
    "nmbg-degree-1": Variant("nmbg", {"degree": 1}),
    "nmbg-vertices-1/4": Variant("nmbg", scene={"vertices": 0.25}),
    "nmbg-images-1/2": Variant("nmbg", scene={"images": 0.5}),
    "nmbg-float32": Variant("nmbg", bf16=False),
    "nmbg-bfloat16": Variant("nmbg", bf16=True),
}


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--minutes", default="1,4,15", show_default=True, help="Budgets, separated by commas.")
@click.option("--points", default=",".join(VARIANTS), help="Presets and variants, separated by commas.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--foreign", type=click.Path(path_type=Path), multiple=True, help="Of nmbg eval --renders.")
@click.option("--quick", is_flag=True, help="15 seconds of training a point.")
@weights_option
@output_option("runs, JSON and pictures")
def main(
    scene: Path,
    minutes: str,
    points: str,
    seed: int,
    foreign: Sequence[Path],
    quick: bool,
    weights: Path,
    output: Path,
) -> None:
    """Measure every point and write speed-SCENE.json, .md, .svg and .png."""
    budgets = [QUICK] if quick else [float(part) for part in minutes.split(",")]
    named: list[tuple[str, Job]] = []
    for name in points.split(","):
        variant = VARIANTS[name]
        folder = smaller_scene(scene, output / "scenes", **variant.scene)
        wanted = budgets if name in PRESETS else budgets[len(budgets) // 2 :][:1]
        for budget in wanted if PRESETS[variant.preset].stages else [0.0]:
            config = trained_for(variant.preset, budget, seed)
            config = replace(config, model=replace(config.model, **variant.model))
            named.append((name, Job(folder, config, bf16=variant.bf16)))
    records = Sweep(output, weights).measure([job for _, job in named], split=False)
    measured = [
        _point(name, job, record, _again(scene, name, job, weights, output))
        for (name, job), record in zip(named, records, strict=True)
    ]
    others = [_nearest(scene, output, weights), *(read_results(folder) for folder in foreign)]
    measured += [_foreign_point(report) for report in others]
    fronts = {f"{metric} / {cost}": _front(measured, metric, cost) for metric in METRICS for cost in COSTS}
    results = {
        "command": command(),
        **provenance(),
        "scene": scene.name,
        "seed": seed,
        "points": measured,
        "fronts": fronts,
    }
    name, table, picture = f"speed-{scene.name}", _table(results), _draw(measured)
    write(output, name, results, table)
    for suffix, content in ((".svg", picture.encode()), (".png", _png(picture))):
        with atomic_file(output / f"{name}{suffix}") as path:
            path.write_bytes(content)
    click.echo(table)


def _again(scene: Path, name: str, job: Job, weights: Path, output: Path) -> str:
    """The command that measures one point alone."""
    words = ["python", "benchmarks/speed_accuracy.py", scene, "--points", name]
    words += ["--minutes", f"{job.config.minutes:g}"] if job.config.minutes else []
    words += ["--seed", job.config.seed, "--weights", weights, "--output", output]
    return shlex.join(map(str, words))


def _point(name: str, job: Job, record: dict[str, Any], again: str) -> dict[str, Any]:
    figures = record["figures"]
    return {
        "name": name,
        "budget": job.config.minutes or 0.0,
        **{metric: figures[metric] for metric in METRICS},
        "minutes": figures["seconds"] / 60,
        "milliseconds": 1000 * figures["seconds_per_frame"],
        "megabytes": figures["megabytes"],
        "command": again,
        "seed": job.config.seed,
        "commit": record["commit"],
        "machine": record["machine"],
        "run": job.key,
    }


def _foreign_point(report: Report) -> dict[str, Any]:
    """A point whose costs are what its user told, None where he did not."""

    def times(value: float | None, factor: float) -> float | None:
        return None if value is None else factor * value

    return {
        "name": report.run,
        "budget": None,
        **{metric: report.mean.get(metric) for metric in METRICS},
        "minutes": times(report.train_seconds, 1 / 60),
        "milliseconds": times(report.seconds_per_frame, 1000),
        "megabytes": report.megabytes,
        "machine": report.machine,
    }


def _nearest(folder: Path, output: Path, weights: Path) -> Report:
    """The nearest photograph warped as it is, through the same measures as another program's pictures."""
    results = output / "work" / f"{folder.name}-nearest-eval"
    if (results / "metrics.json").exists():
        return read_results(results)
    scene, renders = Scene.load(folder), output / "work" / f"{folder.name}-nearest"
    seconds = render_nearest(scene, renders)
    files = [folder / "geometry.ply", *(folder / "images" / view.image for view in scene.train)]
    return evaluate_renders(
        renders,
        folder,
        "nearest photograph",
        results,
        ("psnr", "ssim", "lpips"),
        lpips_net="squeeze",
        weights=weights,
        seconds_per_frame=seconds,
        train_seconds=0.0,
        megabytes=sum(file.stat().st_size for file in files) / 1e6,
    )


def _front(points: Sequence[dict[str, Any]], metric: str, cost: str) -> list[int]:
    """Indices of the points on one chart's front, the cheapest first."""
    known = [i for i, p in enumerate(points) if p[cost] is not None and p[metric] is not None]
    sign = 1 if METRICS[metric][1] else -1
    return [known[i] for i in pareto_front([(points[k][cost], sign * points[k][metric]) for k in known])]


def _draw(points: Sequence[dict[str, Any]]) -> str:
    names = list(dict.fromkeys(point["name"] for point in points))
    best = max((point["psnr"] for point in points if point["psnr"] is not None), default=0.0)

    def series(metric: str, cost: str, least: float = -math.inf) -> list[Series]:
        # What takes no time stands at the left end of a logarithmic axis: a second.
        places = [
            None
            if p[cost] is None or p[metric] is None or p[metric] < least
            else (max(p[cost], 1 / 60 if cost == "minutes" else 0), p[metric])
            for p in points
        ]
        front = [place for i in _front(points, metric, cost) if (place := places[i])]
        lines = [Series(FRONT, front, marks=False, dashed=True, colour="#555")]
        for k, name in enumerate(names):
            own = [place for p, place in zip(points, places, strict=True) if p["name"] == name and place]
            shape, colour = k // len(COLOURS), COLOURS[k % len(COLOURS)]
            lines.append(Series(name, own, line=cost == "minutes", colour=colour, shape=shape))
        return lines

    rows = [(metric, Axis(label, log=not more), -math.inf) for metric, (label, more) in METRICS.items()]
    rows.insert(1, ("psnr", Axis(f"PSNR, dB, the best {CLOSE:g}"), best - CLOSE))
    charts = [
        chart(series(metric, cost, least), Axis(told, log=True), up, size=SIZE)
        for metric, up, least in rows
        for cost, told in COSTS.items()
    ]
    return figure(charts, series("psnr", "minutes"), len(COSTS), SIZE)


def _png(picture: str) -> bytes:
    import resvg_py

    return bytes(resvg_py.svg_to_bytes(svg_string=picture, zoom=2))


def _table(results: dict[str, Any]) -> str:
    points = results["points"]
    # Of kept runs, whatever tabulates them.
    machines = [point["machine"] for point in points if point["budget"] is not None]
    told = " and ".join(dict.fromkeys(f"{one['cpu']}, {one['threads']} threads" for one in machines))
    lines = [
        f"Held-out views of {results['scene']}; {told}, seed {results['seed']}. What is not known of another "
        "program's pictures is left empty.",
        "",
        f"| point | budget, minutes | {' | '.join(label for label, _ in METRICS.values())} | "
        f"{' | '.join(COSTS.values())} |",
        "|---|---|" + "---|" * (len(METRICS) + len(COSTS)),
    ]
    for point in points:
        digits = {"psnr": ".2f", "ssim": ".4f", "lpips_squeeze": ".4f", **dict.fromkeys(COSTS, ".3g")}
        cells = ["" if point[key] is None else f"{point[key]:{form}}" for key, form in digits.items()]
        budget = "" if point["budget"] is None else f"{point['budget']:g}"
        lines.append(f"| {point['name']} | {budget} | {' | '.join(cells)} |")
    lines += ["", "Pareto fronts, the cheapest first:", ""]
    for chart_name, front in results["fronts"].items():
        told = [
            points[i]["name"] + (f" ({points[i]['budget']:g})" if points[i]["budget"] else "") for i in front
        ]
        lines.append(f"- {chart_name}: {', '.join(told)}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
