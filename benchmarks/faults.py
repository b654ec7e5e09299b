"""What one fault among the training photographs costs the held-out views.

Example:
    python benchmarks/faults.py out/fox --weights DIR --output out/faults

Faults: a black photograph, a wrong one, one pose wildly wrong, a view that sees no geometry, and losses of
one view that are not finite (photographs are of bytes: none can hold a NaN). Budgets are those of
stability.py, in steps. Finished runs are kept. `--quick` takes mesh and photos, and a quarter of the steps.
"""

from __future__ import annotations

import os
import shutil
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
from sweep import STEPS, Job, Sweep, trained_in_steps

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
    "none": lambda scene, view: scene,
    "black photograph": black,
    "wrong photograph": wrong_photograph,
    "wrong pose": wrong_pose,
    "sees nothing": sees_nothing,
    "not finite": lambda scene, view: scene,
}


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--presets", default=",".join(PRESETS), show_default=True, help="Separated by commas.")
@click.option("--quick", is_flag=True, help="Mesh and photos, a quarter of the steps.")
@weights_option
@output_option("runs, JSON and table")
def main(scene: Path, presets: str, quick: bool, weights: Path, output: Path) -> None:
    """Train with every fault in turn; write faults.json and faults.md."""
    sweep, rows = Sweep(output, weights), {}
    names = [preset for preset in presets.split(",") if not quick or preset in ("mesh", "photos")]
    name = Scene.load(scene).train[len(Scene.load(scene).train) // 2].name
    for fault, spoil in FAULTS.items():
        folder = output / "scenes" / f"{scene.name}-{fault.replace(' ', '-')}"
        if not (folder / "scene.json").exists():
            shutil.copytree(scene, folder, dirs_exist_ok=True)
            copy = Scene.load(folder)
            spoil(copy, next(view for view in copy.views if view.name == name)).save(folder)
        jobs = [Job(folder, trained_in_steps(preset, quick=quick)) for preset in names]
        losses = loop.losses
        if fault == "not finite":
            loop.losses = _poisoned(losses, name)
        try:
            records = sweep.measure(jobs, split=False)
        finally:
            loop.losses = losses
        rows[fault] = {
            job.config.preset: {
                **record["figures"],
                "named": name in record["left_out"] or name in record["figures"]["skipped"],
            }
            for job, record in zip(jobs, records, strict=True)
        }
    results = {
        "command": command(),
        "scene": scene.name,
        "view": name,
        "iterations": STEPS,
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
    presets = list(rows["none"])
    lines = [
        f"Scene {results['scene']}; one fault at training view {results['view']}.",
        "PSNR of the held-out views, dB, what the fault costs, and whether the run names the view.",
        "",
        f"| fault | {' | '.join(presets)} |",
        "|---|" + "---|" * len(presets),
    ]
    for fault, row in rows.items():
        cells = []
        for preset in presets:
            cost = rows["none"][preset]["psnr"] - row[preset]["psnr"]
            told = (
                ""
                if fault == "none"
                else f" ({cost:+.2f}; {'named' if row[preset]['named'] else 'not named'})"
            )
            cells.append(f"{row[preset]['psnr']:.2f}{told}")
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
