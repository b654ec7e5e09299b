"""How many new views a second each preset renders, and where the time goes.

    python benchmarks/frames.py out/fox [--output benchmarks/results]

Fresh cameras: nothing of a view is kept but the photographs themselves. Models have taken no step: what they
show is of no matter here.
"""

from __future__ import annotations

import os
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import torch
from record import command, provenance, write
from sweep import untrained
from timing import show, timed
from torch.profiler import ProfilerActivity, profile

from nmbg.scene import Scene

LONGER_SIDES = (480, 960, 1920)
SHOWN = ("mesh", "photos", "photos-mesh", "nmbg", "npbg", "paper")
STAGES = {
    "nmbg::rasterize_faces": "faces",
    "nmbg::rasterize_points": "points",
    "nmbg::shade": "shading",
    "nmbg::blend_photos": "blending",
    "aten::conv2d": "convolutions",
}


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("benchmarks/results"), show_default=True
)
@click.option("--repeats", type=click.IntRange(min=5), default=7, show_default=True)
def main(scene: Path, output: Path, repeats: int) -> None:
    """Time new views of each preset.

    Example: python benchmarks/frames.py out/fox
    """
    loaded = Scene.load(scene)
    held_out = (loaded.test or loaded.train)[0].camera
    rows: list[dict[str, Any]] = []
    for name in SHOWN:
        with tempfile.TemporaryDirectory() as folder:
            run = untrained(scene, name, Path(folder) / name)
            for longer in LONGER_SIDES:
                scale = longer / max(held_out.width, held_out.height)
                camera = held_out.resized(round(scale * held_out.width), round(scale * held_out.height))
                render = partial(run.renderer.render, camera)
                times = timed(render, repeats)
                with torch.no_grad(), profile(activities=[ProfilerActivity.CPU]) as profiled:
                    render()
                spent = {event.key: event.cpu_time_total / 1000 for event in profiled.key_averages()}
                stages = {stage: spent.get(key, 0.0) for key, stage in STAGES.items()}
                row = {"preset": name, "width": camera.width, "height": camera.height}
                rows.append({**row, "times": times, "stages": stages})
                click.echo(_row(rows[-1]))
    results = {"command": command(), **provenance(), "repeats": repeats, "frames": rows}
    write(output, "frames", results, _table(results))


def _row(row: dict[str, Any]) -> str:
    shares = [f"{milliseconds:.1f}" if milliseconds else "" for milliseconds in row["stages"].values()]
    rest = row["times"]["ms"] - sum(row["stages"].values())
    cells = [row["preset"], f"{row['width']}×{row['height']}", show(row["times"])]
    cells += [f"{1000 / row['times']['ms']:.1f}", *shares, f"{max(0, rest):.1f}"]
    return "| " + " | ".join(cells) + " |"


def _table(results: dict[str, Any]) -> str:
    lines = [
        f"New views, milliseconds: median (quartiles), and the parts of one frame. {results['machine']}",
        "",
        "| preset | image | frame | a second | " + " | ".join(STAGES.values()) + " | rest |",
        "|---" * (5 + len(STAGES)) + "|",
        *[_row(row) for row in results["frames"]],
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
