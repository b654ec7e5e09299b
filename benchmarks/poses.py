"""Training poses that are off, and what refining them brings back.

Example:
    python benchmarks/poses.py out/fox --weights DIR --output out/poses

Every training camera is turned about a random axis and moved in a random direction, less what they then have
moved together, which no photograph can tell; the held-out ones stay as they were. Stated are what is left of
this, and what `photos` shows of the held-out views with the poses as they were given, disturbed and refined,
and with sound poses refined all the same.
"""

from __future__ import annotations

import os
import shutil
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import numpy as np
from options import output_option, weights_option
from record import cell, command, provenance, write
from scipy.spatial.transform import Rotation
from stress.cameras import disturbed

from nmbg.evaluation.evaluate import evaluate
from nmbg.reconstruct.poses import without_common_motion
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.run_views import load_views
from nmbg.training.trainer import train


def off(scene: Scene, other: Scene) -> dict[str, float]:
    """Median differences of the training cameras: degrees, and percent of the radius."""
    pairs = [(a.camera, b.camera) for a, b in zip(scene.train, other.train, strict=True)]
    turns = [np.degrees(Rotation.from_matrix(a.R @ b.R.T).magnitude()) for a, b in pairs]
    steps = [100 * np.linalg.norm(a.centre - b.centre) / scene.radius for a, b in pairs]
    return {"degrees": statistics.median(turns), "percent": float(statistics.median(steps))}


def apart(scene: Scene, other: Scene) -> Scene:
    """The other scene, its training cameras moved back as a whole to where the scene's are."""
    cameras = without_common_motion([v.camera for v in scene.train], [v.camera for v in other.train])
    moved = {v.name: replace(v, camera=c) for v, c in zip(other.train, cameras, strict=True)}
    return replace(other, views=tuple(moved.get(view.name, view) for view in other.views))


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--degrees", type=float, default=0.2, show_default=True)
@click.option("--share", type=float, default=0.005, show_default=True, help="Of the foreground radius.")
@click.option("--seed", type=int, default=0, show_default=True)
@weights_option
@output_option("JSON and table")
def main(scene: Path, degrees: float, share: float, seed: int, weights: Path, output: Path) -> None:
    """Disturb, refine and judge; write poses.json and poses.md."""
    sound, rows = Scene.load(scene), {}
    for name, start in (
        ("sound", sound),
        ("disturbed", apart(sound, disturbed(sound, degrees, share, np.random.default_rng(seed)))),
    ):
        folder = output / name
        shutil.copytree(scene, folder, dirs_exist_ok=True)
        start.save(folder)
        for refine in ("none", "poses"):
            # No view is left out as doubtful: all are compared.
            config = replace(PRESETS["photos"], refine=refine, inspect=False)
            run = train(Scene.load(folder), config, output / f"{name}-{refine}", overwrite=True)
            report = evaluate(run, ["psnr", "ssim", "lpips"], "squeeze", weights)
            row = "as they are" if refine == "none" else "refined"
            rows[f"{name}, {row}"] = {**off(sound, load_views(run, Scene.load(folder))), **report.mean}
    results: dict[str, Any] = {"command": command(), "scene": scene.name, **provenance(), "rows": rows}
    table = [
        f"Scene {scene.name}: training cameras turned by {degrees}°, moved by {100 * share} % of the radius.",
        "`photos` on the held-out views, PSNR / SSIM / LPIPS-Squeeze.",
        "",
        "| training poses | off by, median | held-out views |",
        "|---|---|---|",
        *(
            f"| {name} | {row['degrees']:.3f}°, {row['percent']:.3f} % | {cell(row)} |"
            for name, row in rows.items()
        ),
    ]
    write(output, "poses", results, "\n".join(table) + "\n")
    click.echo("\n".join(table))


if __name__ == "__main__":
    main()
