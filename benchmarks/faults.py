"""What one fault among the training photographs costs the held-out views.

Example:
    python benchmarks/faults.py out/fox --weights DIR --output out/faults

Faults: a black photograph, a wrong one, one pose wildly wrong, a view that sees no geometry, and losses of
one view that are not finite (photographs are of bytes: none can hold a NaN). Budgets are those of
stability.py, in steps; `--times` takes so many times these, `--seeds` so many runs of each, which tell what a
fault costs from what runs differ by. Finished runs are kept. `--quick` takes mesh and photos, one seed and a
quarter of the steps.
"""

from __future__ import annotations

import os
import shutil
import statistics
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import numpy as np
import torch
from options import output_option, weights_option
from record import command, provenance, write
from sweep import QUICK, STEPS, Job, Sweep, spread, trained_in_steps

from nmbg.images import write_image
from nmbg.scene import Scene, View
from nmbg.training import loop

PRESETS = ("mesh", "photos", "npbg", "paper", "nmbg")


def black(scene: Scene, view: View) -> Scene:
    """The photograph is black."""
    write_image(scene.folder / "images" / view.image, np.zeros_like(scene.load_image(view)))
    return scene


def wrong_photograph(scene: Scene, view: View) -> Scene:
    """The photograph is that of a view far away in the order."""
    others = [v for v in scene.train if v.camera.width == view.camera.width]
    other = others[(others.index(view) + len(others) // 2) % len(others)]
    write_image(scene.folder / "images" / view.image, scene.load_image(other))
    return scene


def wrong_pose(scene: Scene, view: View) -> Scene:
    """The pose is that of a view far away in the order."""
    i = scene.train.index(view)
    other = scene.train[(i + len(scene.train) // 2) % len(scene.train)].camera
    return _moved(scene, view, other.R, other.t)


def sees_nothing(scene: Scene, view: View) -> Scene:
    """Everything lies behind the camera."""
    return _moved(scene, view, view.camera.R, view.camera.t + np.array([0, 0, -1e3 * scene.radius]))


def _moved(scene: Scene, view: View, R: Any, t: Any) -> Scene:
    camera = replace(view.camera, R=R, t=t)
    return replace(scene, views=tuple(replace(v, camera=camera) if v is view else v for v in scene.views))


FAULTS: dict[str, Callable[[Scene, View], Scene]] = {
    "black photograph": black,
    "wrong photograph": wrong_photograph,
    "wrong pose": wrong_pose,
    "sees nothing": sees_nothing,
    "not finite": lambda scene, view: scene,
}


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--presets", default=",".join(PRESETS), show_default=True, help="Separated by commas.")
@click.option("--faults", default=",".join(FAULTS), show_default=True, help="Separated by commas.")
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True, help="How many.")
@click.option("--times", type=float, default=1.0, show_default=True, help="So many times the steps.")
@click.option("--quick", is_flag=True, help="Mesh and photos, one seed, a quarter of the steps.")
@weights_option
@output_option("runs, JSON and table")
def main(
    scene: Path,
    presets: str,
    faults: str,
    seeds: int,
    times: float,
    quick: bool,
    weights: Path,
    output: Path,
) -> None:
    """Train with every fault in turn; write faults.json and faults.md."""
    chosen = faults.split(",")
    if not set(chosen) <= FAULTS.keys():
        raise click.UsageError(f"--faults {faults}: choose from {', '.join(FAULTS)}")
    seeds, times = (1, QUICK) if quick else (seeds, times)
    sweep, rows = Sweep(output, weights), {}
    names = [preset for preset in presets.split(",") if not quick or preset in ("mesh", "photos")]
    train = Scene.load(scene).train
    name = train[len(train) // 2].name
    for fault in ("none", *chosen):
        folder = output / "scenes" / f"{scene.name}-{fault.replace(' ', '-')}"
        if not (folder / "scene.json").exists():
            shutil.copytree(scene, folder, dirs_exist_ok=True)
            copy = Scene.load(folder)
            view = next(view for view in copy.views if view.name == name)
            (copy if fault == "none" else FAULTS[fault](copy, view)).save(folder)
        jobs = [
            Job(folder, trained_in_steps(preset, seed, times)) for preset in names for seed in range(seeds)
        ]
        losses = loop.losses
        if fault == "not finite":
            loop.losses = _poisoned(losses, name)
        try:
            records = sweep.measure(jobs, split=False)
        finally:
            loop.losses = losses
        row: dict[str, list[dict[str, Any]]] = {}
        for job, record in zip(jobs, records, strict=True):
            named = name in record["left_out"] or name in record["figures"]["skipped"]
            run = {"figures": record["figures"], "named": named, "seed": job.config.seed}
            row.setdefault(job.config.preset, []).append(run)
        rows[fault] = row
    results = {
        "command": command(),
        "scene": scene.name,
        "view": name,
        "iterations": STEPS,
        "times": times,
        **provenance(),
        "rows": rows,
    }
    write(output, "faults", results, _table(results))
    click.echo(_table(results))


def _poisoned(losses: Callable[..., Any], name: str) -> Callable[..., Any]:
    def poison(image: torch.Tensor, stage: Any, *rest: Any) -> Any:
        example = rest[2]
        return losses(image * (torch.nan if example.name == name else 1.0), stage, *rest)

    return poison


def _table(results: dict[str, Any]) -> str:
    rows = results["rows"]
    sound = rows["none"]
    lines = [
        f"Scene {results['scene']}; one fault at training view {results['view']}; {results['times']:g} times "
        "the steps of stability.py.",
        "PSNR of the held-out views, dB (mean ± half of the range of the seeds), what the fault costs, and "
        "whether every run names the view.",
        "",
        f"| fault | {' | '.join(sound)} |",
        "|---|" + "---|" * len(sound),
    ]
    for fault, row in rows.items():
        cells = []
        for preset, runs in row.items():
            cost = _mean(sound[preset]) - _mean(runs)
            named = "named" if all(run["named"] for run in runs) else "not named"
            told = "" if fault == "none" else f" ({cost:+.2f}; {named})"
            cells.append(f"{spread(runs, 'psnr', 2)}{told}")
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _mean(runs: list[dict[str, Any]]) -> float:
    return statistics.fmean(run["figures"]["psnr"] for run in runs)


if __name__ == "__main__":
    main()
