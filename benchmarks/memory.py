"""The most memory that training takes, and how it grows with the number of photographs.

Example:
    python benchmarks/memory.py out/bonsai --output out/memory

Each run is a process of its own; its peak is what the system tells of it when it has ended. Of the training
views a quarter, a half, and all are trained on, evenly spread.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from options import output_option
from record import command, provenance, write

from nmbg.scene import Scene, evenly

PRESETS = ("mesh", "nmbg")
SHARES = (4, 2, 1)


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--steps", type=int, default=40, show_default=True, help="Of training.")
@click.option("--cache", type=float, default=1.0, show_default=True, help="GiB, as nmbg train --cache.")
@output_option("scenes, runs, JSON and table")
def main(scene: Path, steps: int, cache: float, output: Path) -> None:
    """Train on ever more of SCENE's photographs; write memory.json and memory.md."""
    whole, rows = Scene.load(scene), []
    for share in SHARES:
        kept = evenly(whole.train, len(whole.train) // share)
        folder = part_of(whole, [view.name for view in kept], output / "scenes" / f"{scene.name}-{len(kept)}")
        words = ["--iterations", steps, "--cache", cache, "--overwrite"]
        peaks = {
            preset: peak([folder, "--preset", preset, "--output", output / "work" / preset, *words])
            for preset in PRESETS
        }
        rows.append({"views": len(kept), "gib": peaks})
    camera = whole.train[0].camera
    results = {
        "command": command(),
        **provenance(),
        "scene": scene.name,
        "size": (camera.width, camera.height),
        "rows": rows,
    }
    write(output, "memory", results, _table(results))
    click.echo(_table(results))


def part_of(scene: Scene, names: list[str], folder: Path) -> Path:
    """A folder of the scene with these training views alone; its photographs are those of the scene."""
    if not (folder / "scene.json").exists():
        folder.mkdir(parents=True)
        for kind in ("images", "masks"):
            if (scene.folder / kind).exists():
                (folder / kind).symlink_to((scene.folder / kind).resolve())
        views = tuple(view for view in scene.views if view.split == "test" or view.name in names)
        replace(scene, views=views).save(folder)
    return folder


def peak(words: list[Any]) -> float:
    """The most memory that `nmbg train` held, GiB."""
    process = subprocess.Popen([sys.executable, "-m", "nmbg", "train", *map(str, words)])
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise click.ClickException(f"nmbg train {' '.join(map(str, words))}: ended with status {status}")
    return usage.ru_maxrss / 2 ** (30 if sys.platform == "darwin" else 20)


def _table(results: dict[str, Any]) -> str:
    width, height = results["size"]
    lines = [
        f"The most memory that training held, GiB: {results['scene']}, {width} × {height}.",
        "",
        f"    {results['command']}",
        "",
        f"| training views | {' | '.join(PRESETS)} |",
        "|---|" + "---|" * len(PRESETS),
    ]
    for row in results["rows"]:
        cells = [f"{row['gib'][preset]:.2f}" for preset in PRESETS]
        lines.append(f"| {row['views']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
