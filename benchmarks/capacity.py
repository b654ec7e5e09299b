"""No more than a scene needs: `--capacity auto`, exported compactly, beside the full size.

Example:
    python benchmarks/capacity.py out/fox out/kitchen --seeds 2 --weights DIR --output out/capacity

Five minutes a run; with `--steps N` both sizes take so many steps instead, whatever else the machine does.
Finished runs are kept: run it again and it goes on where it stopped. `--quick` takes 60 steps and one seed.
Bytes are those that rendering needs: no state of training. Frames of both sizes, and of the preset
`paper`, are timed in turn.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, scenes_argument, weights_option
from record import cell, command, commit, provenance, write
from sweep import METRICS, Job, Sweep, trained_for, untrained
from timing import alternate

from nmbg.capacity.cost import multiply_adds
from nmbg.capacity.export import export_compact
from nmbg.evaluation.cost import run_bytes
from nmbg.evaluation.evaluate import evaluate
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training.checkpoint import load_run

SIZES = ("full", "auto", "paper")


@click.command()
@scenes_argument
@click.option("--minutes", type=float, default=5.0, show_default=True, help="Budget of each run.")
@click.option("--steps", type=int, help="Budget in steps instead.")
@click.option("--seeds", type=int, default=1, show_default=True, help="How many.")
@click.option("--quick", is_flag=True, help="60 steps, one seed.")
@click.option("--repeats", type=click.IntRange(min=5), default=7, show_default=True, help="Timed frames.")
@weights_option
@output_option("runs, JSON and table")
def main(
    scenes: tuple[Path, ...],
    minutes: float,
    steps: int | None,
    seeds: int,
    quick: bool,
    repeats: int,
    weights: Path,
    output: Path,
) -> None:
    """Train both sizes of every scene, export the small one, judge and time them; write capacity.md."""
    steps, seeds = (60, 1) if quick else (steps, seeds)
    budget = {"minutes": minutes if steps is None else None, "iterations": steps}
    sweep = Sweep(output, weights)
    rows: list[dict[str, Any]] = []
    for scene in scenes:
        paper = untrained(scene, "paper", output / "work" / f"{scene.name}-paper").renderer
        for seed in range(seeds):
            full = trained_for("nmbg", budget["minutes"], seed, steps)
            jobs = [Job(scene, full), Job(scene, replace(full, capacity="auto"))]
            sweep.measure(jobs, split=False)
            runs = [sweep.folder(job) for job in jobs]
            small = output / "work" / f"{runs[1].name}-compact"
            runs[1] = export_compact(runs[1], small, overwrite=True)
            row = {"scene": scene.name, "seed": seed, "commit": commit()}
            rows.append({**row, **_compare(scene, runs, paper, repeats, weights)})
            results = {"command": command(), "budget": budget, **provenance(), "rows": rows}
            write(output, "capacity", results, _table(results))
    click.echo(_table(results))


def _compare(scene: Path, runs: list[Path], paper: Renderer, repeats: int, weights: Path) -> dict[str, Any]:
    """Figures of a full run and of a small one; of `paper` what a frame costs."""
    loaded = [load_run(run) for run in runs]
    camera = Scene.load(scene).test[0].camera
    renderers = dict(zip(SIZES, [*(run.renderer for run in loaded), paper], strict=True))
    calls = {name: partial(renderer.render, camera) for name, renderer in renderers.items()}
    times = alternate(calls, repeats)
    found: dict[str, Any] = {
        name: {"multiply_adds": multiply_adds(renderer, camera), "times": times[name]}
        for name, renderer in renderers.items()
    }
    found["choices"] = [str(choice) for choice in loaded[1].config.choices]
    for name, folder in zip(SIZES, runs, strict=False):
        mean = evaluate(folder, METRICS, lpips_net="squeeze", weights=weights).mean
        found[name] |= {**mean, "bytes": run_bytes(folder)}
    return found


def _table(results: dict[str, Any]) -> str:
    budget = {key: value for key, value in results["budget"].items() if value is not None}
    told = ", ".join(f"{value:g} {key}" for key, value in budget.items())
    machine = results["machine"]
    lines = [
        f"`--capacity auto`, exported compactly, beside `full`: {told} a run, {machine['cpu']}, "
        f"{machine['threads']} threads. MB: photographs + geometry + descriptors + network. Beside them the "
        "preset `paper`, untrained: what its frames cost.",
        "",
        "| scene, seed | size | PSNR / SSIM / LPIPS | MB | multiply-adds a frame, G | ms / frame |",
        "|---|---|---|---|---|---|",
    ]
    for row in results["rows"]:
        for name in SIZES:
            figures, shown, held = row[name], "–", "–"
            if "bytes" in figures:
                parts = " + ".join(f"{n / 1e6:.2f}" for n in figures["bytes"].values())
                shown, held = cell(figures), f"{sum(figures['bytes'].values()) / 1e6:.1f} = {parts}"
            lines.append(
                f"| {row['scene']}, {row['seed']} | {name} | {shown} | {held} | "
                f"{figures['multiply_adds'] / 1e9:.2f} | {figures['times']['ms']:.0f} |"
            )
    for row in results["rows"]:
        lines += ["", f"{row['scene']}, seed {row['seed']}:", "", *(f"- {text}" for text in row["choices"])]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
