"""Where methods fail: presets trained on scenes that get worse by degrees, and rendered from unlikely places.

Example:
    python benchmarks/stability.py out/fox --weights DIR --output out/stability

Budgets are steps, so that a curve does not depend on what else runs: about a minute each on two idle cores,
but for mesh, which has its ten passes in seconds.
The full form is 329 runs a scene, some 8 hours; `--quick` takes the middle severity of each stress, a quarter
of the steps, and the presets mesh and photos. Finished runs are kept; `--finished` tabulates what is there.
"""

from __future__ import annotations

import os
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, weights_option
from record import command, provenance, write
from stress import STRESSES, Stress, Stressed
from stress.curves import draw, pictures, table
from stress.rendering import RENDERINGS, away, flicker, measure, soak
from sweep import QUICK, STEPS, Job, Sweep, trained_in_steps

from nmbg.atomic import atomic_file
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training.checkpoint import load_run

SHOWN = ("mesh", "photos", "npbg", "paper", "nmbg")
SEEDS = 3
GROUPS = ("views", "geometry", "cameras", "photographs", "mending", "model", "rendering", "seeds")


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--presets", default=",".join(SHOWN), show_default=True, help="Separated by commas.")
@click.option("--groups", default=",".join(GROUPS), show_default=True, help="Of stresses, by commas.")
@click.option("--cameras", type=int, default=10_000, show_default=True, help="Random ones of the soak.")
@click.option("--quick", is_flag=True, help="Mesh and photos, one severity, a quarter of the steps.")
@click.option("--finished", is_flag=True, help="Measure nothing, tabulate what is there.")
@weights_option
@output_option("runs, JSON and pictures")
def main(
    scene: Path,
    presets: str,
    groups: str,
    cameras: int,
    quick: bool,
    finished: bool,
    weights: Path,
    output: Path,
) -> None:
    """Train, judge and render; write stability-SCENE.json, .md, .svg and sheets."""
    names, chosen = presets.split(","), groups.split(",")
    if quick:
        names, cameras = [name for name in names if name in ("mesh", "photos")], cameras // 50
    times = QUICK if quick else 1.0
    sweep, sound = Sweep(output, weights), Scene.load(scene)
    failed: dict[str, str] = {}

    def run(job: Job) -> dict[str, Any] | None:
        told = output / "failed" / f"{job.key}.txt"
        if not finished and sweep.found(job) is None:
            try:
                sweep.measure([job], split=False)
            except Exception as error:  # what a stress breaks is a result, too
                with atomic_file(told) as path:
                    path.write_text(f"{type(error).__name__}: {error}")
                click.echo(f"{job.key}: {told.read_text()}")
        record = sweep.found(job)
        if record is None and told.exists():
            failed[job.key] = told.read_text()
        return record

    curves: dict[str, Any] = {}
    for stress in (s for s in STRESSES.values() if s.group in chosen and s.judged(sound, 0)):
        curve: dict[str, Any] = {}
        for severity in severities(stress, quick):
            for name in names:
                if stress.presets is not None and name not in stress.presets:
                    continue
                job = job_for(scene, name, stress, severity, times)
                if (record := run(job)) is not None:
                    judged = [record["views"][view] for view in stress.judged(sound, severity)]
                    point = {
                        metric: sum(view[metric] for view in judged) / len(judged)
                        for metric in ("psnr", "ssim", "lpips_squeeze")
                    }
                    point |= {"severity": severity, "picture": str(sweep.picture(job).relative_to(output))}
                    points = curve.setdefault(name, [])
                    point["loss"] = (points[0] if points else point)["psnr"] - point["psnr"]
                    points.append(point)
        # Of what was not measured yet there is the first point alone, which all stresses share.
        curves[stress.name] = {name: points for name, points in curve.items() if len(points) > 1}
    rendered: dict[str, Any] = {}
    if "rendering" in chosen:
        for name in names:
            job = Job(scene, trained_in_steps(name, times=times))
            if run(job) is None:
                continue
            renderer = cache(partial(_renderer, sweep.folder(job)))
            folder = output / "rendered" / job.key
            for stress in RENDERINGS:
                if points := measure(renderer, sound, stress, folder, finished):
                    curves.setdefault(stress.name, {})[name] = points
            rendered[name] = {
                "away": away(renderer, sound, folder, finished),
                "soak": soak(renderer, sound, cameras, folder, finished),
                "flicker": flicker(renderer, sound, folder, finished),
            }
    spreads: dict[str, list[float]] = {}
    if "seeds" in chosen:
        for name in names:
            for seed in range(1 if quick else SEEDS):
                if (record := run(Job(scene, trained_in_steps(name, seed, times)))) is not None:
                    spreads.setdefault(name, []).append(record["figures"]["psnr"])
    results = {
        "command": command(),
        "scene": scene.name,
        "iterations": STEPS,
        **provenance(),
        "curves": curves,
        "rendered": rendered,
        "seeds": spreads,
        "failed": failed,
    }
    write(output, f"stability-{scene.name}", results, table(results))
    with atomic_file(output / f"stability-{scene.name}.svg") as file:
        file.write_text(draw(results))
    pictures(results, sound, output)
    click.echo(table(results))


def _renderer(run: Path) -> Renderer:
    return load_run(run).renderer


def severities(stress: Stress, quick: bool) -> tuple[float, ...]:
    """Those that are measured; the first changes nothing."""
    middle = stress.severities[len(stress.severities) // 2]
    return (stress.severities[0], middle) if quick else stress.severities


def job_for(scene: Path, preset: str, stress: Stress, severity: float, times: float = 1.0) -> Job:
    """A run of a stress; all stresses share the one without."""
    config = trained_in_steps(preset, times=times)
    if severity == stress.severities[0] or not stress.trains:
        return Job(scene, config)
    if stress.config is not None:
        config = stress.config(config, severity)
    return Job(scene, config, stressed=Stressed(stress, severity) if stress.changes else None)


if __name__ == "__main__":
    main()
