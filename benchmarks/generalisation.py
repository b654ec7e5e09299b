"""What closes the gap between training and held-out views: before and after.

Example:
    python benchmarks/generalisation.py out/fox out/bonsai --seeds 2 --weights DIR --output out/ladder

Finished runs are kept; those of ladder.py with the same budget count, where both write into one folder.
`--quick` takes 20 seconds a run and one seed.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, scenes_argument, weights_option
from record import command, provenance, write
from sweep import Job, Sweep, spread, trained_for

# Of each preset: as it was without a part, then the preset.
PARTS: dict[str, dict[str, dict[str, Any]]] = {
    preset: {"before": {"settle": 2.0}, "statistics held": {}} for preset in ("npbg", "paper")
}


@click.command()
@scenes_argument
@click.option("--minutes", type=float, default=5.0, show_default=True, help="Training time of each run.")
@click.option("--seeds", default="2", show_default=True, help="How many, per scene, separated by commas.")
@click.option("--presets", default=",".join(PARTS), show_default=True, help="Separated by commas.")
@click.option("--quick", is_flag=True, help="20 seconds a run, one seed.")
@weights_option
@output_option("runs, JSON and table")
def main(
    scenes: tuple[Path, ...],
    minutes: float,
    seeds: str,
    presets: str,
    quick: bool,
    weights: Path,
    output: Path,
) -> None:
    """Train and judge every part on every scene; write generalisation.json and generalisation.md."""
    minutes = 1 / 3 if quick else minutes
    counts = [1 if quick else int(count) for count in seeds.split(",")]
    counts += counts[-1:] * (len(scenes) - len(counts))
    results: dict[str, Any] = {"command": command(), "minutes": minutes, **provenance(), "scenes": {}}
    rows = [
        (scene, preset, part, seed)
        for scene, count in zip(scenes, counts, strict=True)
        for preset in presets.split(",")
        for part in PARTS[preset]
        for seed in range(count)
    ]
    jobs = [
        Job(scene, trained_for(preset, minutes, seed, **PARTS[preset][part]))
        for scene, preset, part, seed in rows
    ]
    for (scene, preset, part, _), record in zip(rows, Sweep(output, weights).measure(jobs), strict=True):
        found = results["scenes"].setdefault(scene.name, {}).setdefault(preset, {})
        found.setdefault(part, []).append(record)
    write(output, "generalisation", results, _table(results))
    click.echo(_table(results))


def _table(results: dict[str, Any]) -> str:
    machine = results["machine"]
    lines = [
        f"Held-out views after {results['minutes']:.3g} minutes a run; mean ± half the range of the seeds. "
        f"{machine['cpu']}, {machine['threads']} threads.",
        "",
        "| scene | preset | | seeds | PSNR | SSIM | LPIPS | PSNR, training | steps |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for scene, presets in results["scenes"].items():
        for preset, parts in presets.items():
            for part, records in parts.items():
                figures = (("psnr", 2), ("ssim", 3), ("lpips_squeeze", 3), ("train_psnr", 2), ("steps", 0))
                cells = " | ".join(spread(records, name, digits) for name, digits in figures)
                lines.append(f"| {scene} | {preset} | {part} | {len(records)} | {cells} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
