"""What each rung of the ladder adds: presets trained for equal time, judged on held-out views.

Example:
    python benchmarks/ladder.py out/fox out/bonsai --minutes 3 --seeds 3,1 --weights DIR --output out/ladder

Of each scene so many seeds. Finished runs are kept: run it again and it goes on where it stopped. `--quick`
takes 20 seconds a rung and one seed; the full form 35 minutes a scene and seed.
"""

from __future__ import annotations

import os
import statistics
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, scenes_argument, weights_option
from record import cell, command, provenance, write
from sweep import TRAINING_VIEWS, Job, Sweep, spread, trained_for

from nmbg.evaluation.published import dtu_parts
from nmbg.scene import Scene

# Of DTU's views between the training cameras and beyond them.
SHOWN = ("psnr", "ssim", "lpips_squeeze")

# Rung → preset, and what is changed in it.
RUNGS: dict[str, tuple[str, dict[str, Any]]] = {
    **{
        preset: (preset, {})
        for preset in ("npbg", "npbg-radius", "npbg-mesh", "directional", "split", "adversarial", "paper")
    },
    "npbg plain": ("npbg", {"hide_points": 0.0, "exposure": False}),
    "paper from colours": ("paper", {"start": "mean"}),
    **{preset: (preset, {}) for preset in ("colours", "mesh", "photos", "nmbg")},
}


@click.command()
@scenes_argument
@click.option("--minutes", type=float, default=3.0, show_default=True, help="Training time of each rung.")
@click.option("--seeds", default="1", show_default=True, help="How many, per scene, separated by commas.")
@click.option("--rungs", default=",".join(RUNGS), show_default=True, help="Separated by commas.")
@click.option("--quick", is_flag=True, help="20 seconds a rung, one seed.")
@weights_option
@output_option("runs, JSON and table")
def main(
    scenes: tuple[Path, ...],
    minutes: float,
    seeds: str,
    rungs: str,
    quick: bool,
    weights: Path,
    output: Path,
) -> None:
    """Train and judge every rung on every scene; write ladder-M-minutes.json and .md."""
    minutes = 1 / 3 if quick else minutes
    counts = [1 if quick else int(count) for count in seeds.split(",")]
    counts += counts[-1:] * (len(scenes) - len(counts))
    sweep = Sweep(output, weights)
    results: dict[str, Any] = {"command": command(), "minutes": minutes, **provenance(), "scenes": {}}
    loaded = {scene.name: Scene.load(scene) for scene in scenes}
    cameras = {name: scene.views[0].camera for name, scene in loaded.items()}
    results["sizes"] = {name: (camera.width, camera.height) for name, camera in cameras.items()}
    runs = [
        (scene, rung, seed)
        for scene, count in zip(scenes, counts, strict=True)
        for rung in rungs.split(",")
        for seed in range(count)
    ]
    jobs = [
        Job(scene, trained_for(preset, minutes, seed, **changes))
        for scene, rung, seed in runs
        for preset, changes in (RUNGS[rung],)
    ]
    for (scene, rung, _), record in zip(runs, sweep.measure(jobs), strict=True):
        row = results["scenes"].setdefault(scene.name, {}).setdefault(rung, [])
        row.append({**record, "parts": _parts(loaded[scene.name], record["views"])})
    write(output, f"ladder-{minutes:.2g}-minutes", results, _table(results))
    click.echo(_table(results))


def _parts(scene: Scene, views: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Mean figures between the training cameras and beyond them, where DTU's views were held out."""
    return {
        part: {metric: statistics.fmean(views[name][metric] for name in names) for metric in SHOWN}
        for part, names in dtu_parts(scene).items()
    }


def _processors(rows: dict[str, list[dict[str, Any]]]) -> str:
    """A sweep may go on with another one: where its runs were made, and in which precision."""
    records = [record for runs in rows.values() for record in runs if record["config"]["model"]["widths"]]
    found = {(record["machine"]["cpu"], record["config"]["bf16"]) for record in records}
    return " and ".join(f"{cpu} in {'bfloat16' if bf16 else 'float32'}" for cpu, bf16 in sorted(found))


def _table(results: dict[str, Any]) -> str:
    lines = [
        f"Held-out views after {results['minutes']:.3g} minutes a rung; mean ± half of the "
        "range of the seeds. L_rec up to relu3_1, that of `paper` too; LPIPS of SqueezeNet; training "
        f"PSNR over {TRAINING_VIEWS} views. {results['machine']['threads']} threads."
    ]
    for scene, rows in results["scenes"].items():
        lines += [
            "",
            f"**{scene}**, {results['sizes'][scene][0]} × {results['sizes'][scene][1]}, {_processors(rows)}",
            "",
            "| rung | seeds | PSNR | SSIM | SSIM (SVS) | LPIPS | PSNR, training | steps | ms / frame |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for rung, records in rows.items():
            lpips = next(key for key in records[0]["figures"] if key.startswith("lpips"))
            figures = (("psnr", 2), ("ssim", 3), ("ssim_svs", 3), (lpips, 3), ("train_psnr", 2), ("steps", 0))
            cells = [spread(records, name, digits) for name, digits in figures]
            frame = 1000 * min(record["figures"]["seconds_per_frame"] for record in records)
            lines.append(f"| {rung} | {len(records)} | {' | '.join(cells)} | {frame:.0f} |")
        parts = next(iter(rows.values()))[0]["parts"]
        if parts:
            lines += ["", f"| rung, first seed | {' | '.join(parts)} |", "|---|---|---|"]
            for rung, (first, *_) in rows.items():
                lines.append(f"| {rung} | {' | '.join(cell(part) for part in first['parts'].values())} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
