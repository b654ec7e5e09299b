"""What each part of the default adds: parts switched on one after another, judged on held-out views.

Example:
    python benchmarks/parts.py out/fox out/bonsai --weights ~/weights --output out/parts

What closing holes adds is in closing.py. Finished rows are kept: run again, it goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import torch
from torch import Tensor

from nmbg import __version__
from nmbg.atomic import atomic_file
from nmbg.evaluation.evaluate import evaluate
from nmbg.evaluation.machine import machine
from nmbg.model import photographs
from nmbg.model.exposure import Exposure
from nmbg.scene import Scene
from nmbg.training.config import PRESETS, TrainConfig
from nmbg.training.trainer import train

LPIPS_NET = "squeeze"


@dataclass(frozen=True)
class Part:
    """A model with the parts up to here; `exposure`: photographs are brought to one exposure."""

    name: str
    config: TrainConfig
    exposure: bool = True


def _untrained(preset: str, refine: bool = False) -> TrainConfig:
    budget = {"minutes": None, "epochs": None, "iterations": 0}
    return replace(PRESETS[preset], **budget, refine="geometry" if refine else "none")  # type: ignore[arg-type]


PARTS = (
    Part("fitted colours", _untrained("mesh")),
    Part("photographs over mean colours", _untrained("photos"), exposure=False),
    Part("… and exposure", _untrained("photos")),
    Part("… over fitted colours, 2 × 2 samples", _untrained("nmbg")),
    Part("… and refined geometry", _untrained("nmbg", refine=True)),
)


@click.command()
@click.argument("scenes", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--minutes", type=float, help="And train the default's network for so long.")
@click.option(
    "--weights", type=click.Path(path_type=Path), required=True, help="Folder of pretrained weights."
)
@click.option(
    "--output", type=click.Path(path_type=Path), required=True, help="Folder for runs, JSON and table."
)
def main(scenes: tuple[Path, ...], minutes: float | None, weights: Path, output: Path) -> None:
    """Judge every part on every scene; write parts.json and parts.md."""
    parts = list(PARTS)
    if minutes is not None:
        parts.append(Part(f"… and a network, {minutes:g} min", replace(PRESETS["nmbg"], minutes=minutes)))
    results_path = output / "parts.json"
    results = json.loads(results_path.read_text()) if results_path.exists() else _provenance()
    for scene in scenes:
        rows = results["scenes"].setdefault(scene.name, {})
        for part in parts:
            if part.name in rows:
                continue
            with _exposure(part.exposure):
                start = time.perf_counter()
                run = train(Scene.load(scene), part.config, output / "run", overwrite=True)
                seconds = time.perf_counter() - start
                measured = evaluate(run, ["psnr", "ssim", "lpips"], lpips_net=LPIPS_NET, weights=weights)
            rows[part.name] = {**measured.mean, "seconds": seconds}
            with atomic_file(results_path) as path:
                path.write_text(json.dumps(results, indent=1))
            with atomic_file(output / "parts.md") as path:
                path.write_text(_table(results))
    click.echo(_table(results))


@contextmanager
def _exposure(on: bool) -> Iterator[None]:
    """Take photographs as they are for a while."""
    fit = photographs.fit_exposure

    def none(image: Tensor, colour: Tensor, counted: Tensor) -> Exposure:
        return Exposure(torch.ones(3, 1, 1), torch.zeros(3, 1, 1))

    photographs.fit_exposure = fit if on else none
    try:
        yield
    finally:
        photographs.fit_exposure = fit


def _provenance() -> dict[str, Any]:
    return {
        "command": " ".join(["python", *sys.argv]),
        "nmbg": __version__,
        "torch": torch.__version__,
        "machine": machine("cpu"),
        "scenes": {},
    }


def _table(results: dict[str, Any]) -> str:
    scenes = results["scenes"]
    names = list(dict.fromkeys(name for rows in scenes.values() for name in rows))
    lines = [
        "Held-out views, PSNR / SSIM / LPIPS-Squeeze (seconds until the run is written).",
        f"{results['machine']}",
        "",
        f"| | {' | '.join(scenes)} |",
        f"|---|{'---|' * len(scenes)}",
    ]
    for name in names:
        cells = [_cell(rows[name]) if name in rows else "" for rows in scenes.values()]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _cell(row: dict[str, float]) -> str:
    lpips = next(value for key, value in row.items() if key.startswith("lpips"))
    return f"{row['psnr']:.2f} / {row['ssim']:.3f} / {lpips:.3f} ({row['seconds']:.0f})"


if __name__ == "__main__":
    main()
