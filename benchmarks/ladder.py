"""What each rung of the ladder adds: presets trained for equal time on one scene, judged on held-out views.

Example:
    python benchmarks/ladder.py out/fox --minutes 3 --weights ~/weights --output out/ladder

Finished rungs are kept: run it again and it goes on where it stopped.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from record import command, provenance, write

from nmbg.evaluation.evaluate import evaluate
from nmbg.scene import Scene
from nmbg.training.checkpoint import latest_checkpoint, load_progress, load_run
from nmbg.training.config import PRESETS, VGG_TO_RELU3
from nmbg.training.trainer import train


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--minutes", type=float, default=3.0, show_default=True, help="Training time of each rung.")
@click.option(
    "--weights", type=click.Path(path_type=Path), required=True, help="Folder of pretrained weights."
)
@click.option("--lpips-net", default="squeeze", show_default=True)
@click.option(
    "--output", type=click.Path(path_type=Path), required=True, help="Folder for runs, JSON and table."
)
@click.option("--presets", default=",".join(PRESETS), show_default=True, help="Rungs, separated by commas.")
@click.option("--bf16/--no-bf16", default=True, show_default=True)
def main(
    scene: Path, minutes: float, weights: Path, lpips_net: str, output: Path, presets: str, bf16: bool
) -> None:
    """Train and judge every rung; write ladder.json and ladder.md."""
    results_path = output / "ladder.json"
    new = {"command": command(), "scene": scene.name, "minutes": minutes, **provenance(), "rungs": {}}
    results = json.loads(results_path.read_text()) if results_path.exists() else new
    for name in presets.split(","):
        if name in results["rungs"]:
            continue
        run = output / name
        budget = None if name == "colours" else minutes
        perceptual = "none" if PRESETS[name].perceptual == "none" else VGG_TO_RELU3
        config = replace(
            PRESETS[name], minutes=budget, epochs=None, iterations=None, perceptual=perceptual, bf16=bf16
        )
        train(Scene.load(scene), config, run, weights, overwrite=True)
        results["rungs"][name] = _judge(run, weights, lpips_net)
        write(output, "ladder", results, _table(results))
    click.echo(_table(results))


def _judge(run: Path, weights: Path, lpips_net: str) -> dict[str, float]:
    """Held-out and training metrics of a finished run."""
    metrics = evaluate(run, ["psnr", "ssim", "lpips"], lpips_net=lpips_net, weights=weights)
    training = evaluate(run, ["psnr"], split="train")
    checkpoint = latest_checkpoint(run)
    assert checkpoint is not None
    loaded = load_run(run)
    network = loaded.renderer.network
    return {
        **metrics.mean,
        "train_psnr": training.mean["psnr"],
        "seconds_per_frame": metrics.seconds_per_frame,
        "steps": load_progress(checkpoint).step,
        "network_parameters": 0 if network is None else sum(p.numel() for p in network.parameters()),
    }


def _table(results: dict[str, object]) -> str:
    rungs = results["rungs"]
    assert isinstance(rungs, dict)
    lpips = next((key for row in rungs.values() for key in row if key.startswith("lpips")), "lpips")
    lines = [
        f"Scene {results['scene']}, {results['minutes']:g} minutes a rung, {results['machine']}.",
        "",
        f"| preset | PSNR | SSIM | {lpips} | PSNR, training | steps | ms / frame | network parameters |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, row in rungs.items():
        lines.append(
            f"| {name} | {row['psnr']:.2f} | {row['ssim']:.3f} | {row[lpips]:.3f} | {row['train_psnr']:.2f} "
            f"| {row['steps']} | {1000 * row['seconds_per_frame']:.0f} | {row['network_parameters']:,} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
