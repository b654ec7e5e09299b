"""What stands behind a mesh, and what it is worth: none, shell, closed and the automatic choice.

Example:
    python benchmarks/closing.py captures/fox --name fox --max-size 480 --weights DIR --output out/closing

Judged on held-out views. Captures add to one table; finished rows are kept, so that it can be run again.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
from options import output_option, weights_option
from record import cell, command, provenance, write

from nmbg.evaluation.evaluate import evaluate
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.trainer import train

KINDS = ("none", "shell", "closed")
LPIPS_NET = "squeeze"


@click.command()
@click.argument("capture", type=click.Path(path_type=Path))
@click.option("--name", required=True, help="Name of the capture in the table.")
@click.option("--images", type=click.Path(path_type=Path))
@click.option("--masks", type=click.Path(path_type=Path))
@click.option("--split", type=click.Path(path_type=Path))
@click.option("--max-size", type=int)
@click.option("--iterations", default=400, show_default=True, help="Training steps of mesh.")
@weights_option
@output_option("scenes, JSON and table")
def main(capture: Path, name: str, iterations: int, weights: Path, output: Path, **options: Any) -> None:
    """Preprocess a capture with every background, train and judge; write closing.json and closing.md."""
    results_path = output / "closing.json"
    new = {"iterations": iterations, **provenance(), "captures": {}}
    results = json.loads(results_path.read_text()) if results_path.exists() else new
    found = results["captures"].setdefault(name, {"command": command(), "rows": {}})

    def save() -> None:
        write(output, "closing", results, _table(results))

    if "auto" not in found:
        scene = preprocess(capture, output / f"{name}-auto", PreprocessOptions(**options), overwrite=True)
        found["auto"] = scene.summary["background"]
        save()
    for kind in KINDS:
        folder = output / f"{name}-{kind}"
        if not (folder / "scene.json").exists():
            preprocess(capture, folder, PreprocessOptions(**options, background=kind), overwrite=True)  # type: ignore[arg-type]
        scene = Scene.load(folder)
        row = found["rows"].setdefault(kind, {"closing": scene.summary["closing"]})
        for preset, steps in (("photos", None), ("mesh", iterations)):
            if preset not in row:
                config = replace(PRESETS[preset], minutes=None, epochs=None, iterations=steps)
                run = output / f"{name}-{kind}-{preset}"
                train(scene, config, run, weights, overwrite=True)
                metrics = evaluate(run, ["psnr", "ssim", "lpips"], lpips_net=LPIPS_NET, weights=weights)
                row[preset] = metrics.mean
                save()
    click.echo(_table(results))


def _table(results: dict[str, Any]) -> str:
    machine_ = results["machine"]
    lines = [
        f"Held-out views, PSNR / SSIM / LPIPS-Squeeze; `mesh` after {results['iterations']} steps, `photos` "
        "untrained. **Bold**: what the",
        f"automatic choice took, on training views alone. {machine_['cpu']}, {machine_['threads']} threads.",
        "",
        "| capture | background | training pixels without mesh → without mesh or patch, % | photos | mesh |",
        "|---|---|---|---|---|",
    ]
    for name, found in results["captures"].items():
        for kind, row in found["rows"].items():
            label = f"**{kind}**" if kind == found["auto"]["chosen"] else kind
            closing = row["closing"]
            shares = f"{100 * closing['open_before']:.2f} → {100 * closing['open_after']:.2f}"
            cells = [cell(row[preset]) if preset in row else "" for preset in ("photos", "mesh")]
            lines.append(f"| {name} | {label} | {shares} | {' | '.join(cells)} |")
    lines += ["", *(f"- {name}: {found['auto']['why']}" for name, found in results["captures"].items())]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
