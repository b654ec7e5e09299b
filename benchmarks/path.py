"""Whether a moving camera sees pops: frames of a smooth path, each compared with the one before it, warped.

Example:
    python benchmarks/path.py out/fox-run out/fox-mesh --frames 60 --output out/path
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import numpy as np
from options import output_option
from record import command, provenance, write
from torch import Tensor
from warp import psnr, warped

from nmbg.atomic import atomic_file
from nmbg.cameras import Camera
from nmbg.evaluation.figures import Row, sheet
from nmbg.images import to_bytes, write_image
from nmbg.paths import through
from nmbg.progress import progress_bar
from nmbg.scene import Scene
from nmbg.sight import look
from nmbg.training.checkpoint import load_run

SHOWN = 5  # frames of a row of the contact sheet


class Step(NamedTuple):
    """Mean absolute difference of a frame and the one before it, and PSNR, dB; None where nothing is seen."""

    difference: float
    psnr: float | None


@click.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--frames", type=click.IntRange(min=2), default=60, show_default=True)
@click.option("--first", type=int, default=0, show_default=True, help="Training view where the path starts.")
@click.option("--views", type=click.IntRange(min=2), default=4, show_default=True, help="Views on the path.")
@output_option("JSON and sheet")
def main(runs: tuple[Path, ...], frames: int, first: int, views: int, output: Path) -> None:
    """Render one path with each of RUNS, which share a scene, and measure how much neighbours differ."""
    scene = Scene.load(load_run(runs[0]).source)
    path = through([view.camera for view in scene.train[first : first + views]], frames)
    depths = [look(scene.mesh, camera).depth for camera in path]
    results: dict[str, Any] = {
        "command": command(),
        **provenance(),
        "scene": scene.source,
        "views": [view.name for view in scene.train[first : first + views]],
        "frames": frames,
        "runs": {},
    }
    rows = []
    for run in runs:
        renderer = load_run(run).renderer
        with progress_bar() as bar:
            images = [renderer.render(camera) for camera in bar.track(path, description=run.name)]
        steps = differences(images, path, depths)
        errors = [step.difference for step in steps]
        results["runs"][run.name] = {
            "mean": float(np.mean(errors)),
            "largest": float(np.max(errors)),
            "largest_over_median": float(np.max(errors) / np.median(errors)),
            "psnr": float(np.mean([step.psnr for step in steps if step.psnr is not None])),
            "steps": errors,
        }
        shown = np.linspace(0, frames - 1, SHOWN).round().astype(int)
        rows.append(Row(run.name, tuple(to_bytes(images[i]) for i in shown)))
        headings = [f"frame {i}" for i in shown]
    output.mkdir(parents=True, exist_ok=True)
    with atomic_file(output / "sheet.png") as picture:
        write_image(picture, sheet(rows, headings))
    write(output, "path", results, _table(results))
    click.echo(_table(results))


def _table(results: dict[str, Any]) -> str:
    lines = [
        f"{results['frames']} frames between training views of {results['scene']}: mean absolute difference "
        "of neighbours, warped.",
        "",
        "| run | mean | largest | … times the median | PSNR, dB |",
        "|---|---|---|---|---|",
    ]
    for name, row in results["runs"].items():
        figures = f"{row['mean']:.5f} | {row['largest']:.5f} | {row['largest_over_median']:.2f}"
        lines.append(f"| {name} | {figures} | {row['psnr']:.2f} |")
    return "\n".join(lines) + "\n"


def differences(images: Sequence[Tensor], path: Sequence[Camera], depths: Sequence[Tensor]) -> list[Step]:
    """How each frame of a path differs from the one before, warped, where both see a point."""
    steps = []
    for i in range(len(images) - 1):
        before, seen = warped(images[i], path[i], depths[i], path[i + 1], depths[i + 1])
        mean = float((images[i + 1] - before).abs().mean(0)[seen].mean())
        steps.append(Step(mean, psnr(images[i + 1], before, seen)))
    return steps


if __name__ == "__main__":
    main()
