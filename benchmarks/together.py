"""One network over several scenes: what it is worth on another scene, and what a second process saves.

Example:
    python benchmarks/together.py out/fox out/bonsai out/kitchen --target out/dtu24 \\
        --weights DIR --output out/together

Each preset is trained on all scenes, then fine-tuned on the target, beside training on the target alone for
as long as the fine-tuning. Then some epochs of the preset `nmbg` on all scenes in one process of two threads,
three seeds, and in two processes of one thread under torchrun. Finished runs are kept. `--quick` takes half a
minute a run and one epoch; the full form 40 to 70 minutes on two cores.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import torch
from options import output_option, scenes_argument, weights_option
from record import cell, command, provenance, write
from sweep import METRICS, Job, Sweep, in_precision, trained_for

from nmbg.atomic import atomic_file
from nmbg.evaluation.evaluate import evaluate
from nmbg.training.checkpoint import SCENES, latest_checkpoint, load_progress
from nmbg.training.full import train_together

PRESETS = ("paper", "nmbg")
SEEDS = (0, 1, 2)


@click.command()
@scenes_argument
@click.option("--target", type=click.Path(path_type=Path), required=True, help="Scene to fine-tune on.")
@click.option("--minutes", type=float, default=10.0, show_default=True, help="Training on all scenes.")
@click.option("--tuning", type=float, default=3.0, show_default=True, help="Minutes on the target.")
@click.option("--epochs", type=int, default=6, show_default=True, help="Of each run that counts processes.")
@click.option("--quick", is_flag=True, help="Half a minute a run, one epoch.")
@weights_option
@output_option("runs, JSON and table")
def main(
    scenes: tuple[Path, ...],
    target: Path,
    minutes: float,
    tuning: float,
    epochs: int,
    quick: bool,
    weights: Path,
    output: Path,
) -> None:
    """Train, fine-tune and judge; write together.json and together.md."""
    if quick:
        minutes = tuning = 0.5
        epochs = 1
    sweep = Sweep(output, weights)
    results: dict[str, Any] = {"command": command(), **provenance(), "tuned": {}}
    results |= {"minutes": minutes, "tuning": tuning, "epochs": epochs, "target": target.name}
    for preset in PRESETS:
        shared = _shared(scenes, preset, minutes, weights, output / "work" / f"shared-{preset}-{minutes:g}")
        alone, tuned = sweep.measure(
            [Job(target, trained_for(preset, tuning), init) for init in (None, shared)]
        )
        results["tuned"][preset] = {"alone": alone["figures"], "tuned": tuned["figures"]}
    results["processes"] = [
        _counted(scenes, processes, seed, epochs, weights, output)
        for processes, seeds in ((1, SEEDS), (2, SEEDS[:1]))
        for seed in seeds
    ]
    write(output, "together", results, _table(results))
    click.echo(_table(results))


def _shared(scenes: tuple[Path, ...], preset: str, minutes: float, weights: Path, run: Path) -> Path:
    """A run over all scenes; trained now if it is not there."""
    done = run.with_suffix(".done")
    if not done.exists():
        run.parent.mkdir(parents=True, exist_ok=True)
        train_together(scenes, in_precision(trained_for(preset, minutes)), run, weights, overwrite=True)
        done.touch()
    return run


def _counted(
    scenes: tuple[Path, ...], processes: int, seed: int, epochs: int, weights: Path, output: Path
) -> dict[str, Any]:
    """Seconds and held-out metrics of one run in so many processes."""
    name = f"processes-{processes}-{seed}-{epochs}"
    kept = output / "runs" / f"{name}.json"
    if kept.exists():
        record: dict[str, Any] = json.loads(kept.read_text())
        return record
    run = output / "work" / name
    threads = max(1, torch.get_num_threads() // processes)
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes))
    options = ("--epochs", epochs, "--seed", seed, "--overwrite", "--output", run)
    subprocess.run(
        [sys.executable, *launcher, "-m", "nmbg", "train", *map(str, (*scenes, *options))],
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
        check=True,
    )
    found = latest_checkpoint(run)
    assert found is not None
    progress = load_progress(found)
    with (run / "log.csv").open(newline="") as file:
        first, *_, last = csv.DictReader(file)
    # Without what comes before the first step.
    seconds, share = (float(last[name]) - float(first[name]) for name in ("seconds", "progress"))
    record = {
        "processes": processes,
        "seed": seed,
        "steps": progress.step,
        "seconds": progress.seconds,
        "epoch": seconds / (share * epochs),
    }
    record["scenes"] = {
        scene.name: evaluate(run / SCENES / scene.name, METRICS, lpips_net="squeeze", weights=weights).mean
        for scene in scenes
    }
    kept.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(kept) as path:
        path.write_text(json.dumps(record, indent=1))
    return record


def _table(results: dict[str, Any]) -> str:
    machine = results["machine"]
    lines = [
        f"Held-out views, PSNR / SSIM / LPIPS-Squeeze. {machine['cpu']}, {machine['threads']} threads.",
        "",
        f"| preset | {results['target']} alone, {results['tuning']:g} min | network trained on the others "
        f"for {results['minutes']:g} min, then the same |",
        "|---|---|---|",
        *(
            f"| {preset} | {cell(found['alone'])} | {cell(found['tuned'])} |"
            for preset, found in results["tuned"].items()
        ),
        "",
        f"The preset `nmbg` on all scenes, {results['epochs']} epochs:",
        "",
    ]
    names = list(results["processes"][0]["scenes"])
    lines += [
        f"| processes | seed | steps of each | seconds an epoch | in all | {' | '.join(names)} |",
        "|---|---|---|---|---|" + "---|" * len(names),
    ]
    for record in results["processes"]:
        cells = " | ".join(cell(record["scenes"][name]) for name in names)
        run = f"{record['processes']} | {record['seed']} | {record['steps']}"
        lines.append(f"| {run} | {record['epoch']:.1f} | {record['seconds']:.0f} | {cells} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
