"""Held-out PSNR and LPIPS against seconds of training, for several presets.

Example:
    python benchmarks/convergence.py out/fox out/bonsai --weights DIR --output out/convergence

Each point is a run of its own with that budget, so that its rates have decayed; `photos` needs no training,
and `mesh` ends after ten passes.
Finished runs are kept. `--quick` stops at one minute.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, scenes_argument, weights_option
from record import command, provenance, write
from sweep import Job, Sweep, trained_for

from nmbg.atomic import atomic_file
from nmbg.evaluation.charts import Axis, Series, chart, figure

SHOWN = ("mesh", "photos", "paper", "nmbg")
WANTED = (24, 26, 28, 30)


@click.command()
@scenes_argument
@click.option("--minutes", default="0.5,1,2,4", show_default=True, help="Budgets, separated by commas.")
@click.option("--presets", default=",".join(SHOWN), show_default=True, help="Separated by commas.")
@click.option("--quick", is_flag=True, help="Half a minute and one minute.")
@weights_option
@output_option("runs, JSON and picture")
def main(
    scenes: tuple[Path, ...], minutes: str, presets: str, quick: bool, weights: Path, output: Path
) -> None:
    """Train and judge every preset at every budget; write convergence.json, .md and .svg."""
    budgets = [0.5, 1.0] if quick else [float(part) for part in minutes.split(",")]
    jobs = [
        Job(scene, trained_for(preset, budget))
        for scene in scenes
        for preset in presets.split(",")
        for budget in (budgets if preset != "photos" else budgets[:1])
    ]
    curves: dict[str, dict[str, list[dict[str, float]]]] = {}
    for job, record in zip(jobs, Sweep(output, weights).measure(jobs), strict=True):
        figures = record["figures"]
        point = {key: figures[key] for key in ("seconds", "steps", "psnr", "ssim", "lpips_squeeze")}
        curves.setdefault(job.scene.name, {}).setdefault(job.config.preset, []).append(point)
    results = {"command": command(), **provenance(), "curves": curves}
    write(output, "convergence", results, _table(curves))
    with atomic_file(output / "convergence.svg") as path:
        path.write_text(_draw(curves), encoding="utf-8")
    click.echo(_table(curves))


def _table(curves: dict[str, dict[str, list[dict[str, float]]]]) -> str:
    lines = [
        "PSNR / LPIPS-Squeeze of held-out views (seconds until the run is written); then the seconds of the",
        "shortest of these runs that reaches a PSNR.",
        "",
        f"| scene | preset | runs | {' | '.join(f'{wanted} dB' for wanted in WANTED)} |",
        "|---|---|---|" + "---|" * len(WANTED),
    ]
    for scene, presets in curves.items():
        for preset, points in presets.items():
            shown = ", ".join(
                f"{p['psnr']:.2f} / {p['lpips_squeeze']:.3f} ({p['seconds']:.0f})" for p in points
            )
            reached = [
                min((p["seconds"] for p in points if p["psnr"] >= wanted), default=None) for wanted in WANTED
            ]
            cells = ["–" if seconds is None else f"{seconds:.0f}" for seconds in reached]
            lines.append(f"| {scene} | {preset} | {shown} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _draw(curves: dict[str, Any]) -> str:
    size, charts = (400, 280), []
    presets = list(dict.fromkeys(preset for found in curves.values() for preset in found))
    for metric, label in (("psnr", "PSNR, dB"), ("lpips_squeeze", "LPIPS")):
        for scene, found in curves.items():
            series = [
                Series(preset, [(p["seconds"], p[metric]) for p in found.get(preset, [])])
                for preset in presets
            ]
            charts.append(chart(series, Axis("seconds", log=True), Axis(label), scene, size))
    return figure(charts, [Series(preset, []) for preset in presets], len(curves), size)


if __name__ == "__main__":
    main()
