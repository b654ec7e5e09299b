"""What each part of the default adds: parts switched on one after another, judged on held-out views.

Example:
    python benchmarks/parts.py out/fox out/bonsai --weights ~/weights --output out/parts

What closing holes adds is in closing.py. Finished rows are kept: run again, it goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, scenes_argument, weights_option
from record import cell, command, provenance, write
from torch import Tensor

from nmbg.evaluation.evaluate import evaluate
from nmbg.model import photographs
from nmbg.model.exposure import UNCHANGED, Exposure
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


_photos = _untrained("photos")
_over_means = replace(_photos, start="mean", model=replace(_photos.model, degree=0, sources=5))

PARTS = (
    Part("fitted colours", _untrained("mesh")),
    Part("photographs over mean colours", _over_means, exposure=False),
    Part("… and exposure", _over_means),
    Part("… over fitted colours, 2 × 2 samples", _untrained("nmbg")),
    Part("… and refined geometry", _untrained("nmbg", refine=True)),
)


@click.command()
@scenes_argument
@click.option("--minutes", type=float, help="And train the default's network for so long.")
@weights_option
@output_option("runs, JSON and table")
def main(scenes: tuple[Path, ...], minutes: float | None, weights: Path, output: Path) -> None:
    """Judge every part on every scene; write parts.json and parts.md."""
    parts = list(PARTS)
    if minutes is not None:
        parts.append(Part(f"… and a network, {minutes:g} min", replace(PRESETS["nmbg"], minutes=minutes)))
    results_path = output / "parts.json"
    new = {"command": command(), **provenance(), "scenes": {}}
    results = json.loads(results_path.read_text()) if results_path.exists() else new
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
            write(output, "parts", results, _table(results))
    click.echo(_table(results))


@contextmanager
def _exposure(on: bool) -> Iterator[None]:
    """Take photographs as they are for a while."""
    fit = photographs.fit_exposure

    def none(image: Tensor, colour: Tensor, counted: Tensor) -> Exposure:
        return UNCHANGED

    photographs.fit_exposure = fit if on else none
    try:
        yield
    finally:
        photographs.fit_exposure = fit


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
        found = [rows.get(name) for rows in scenes.values()]
        cells = [f"{cell(row)} ({row['seconds']:.0f})" if row else "" for row in found]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
