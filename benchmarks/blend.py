"""How long blending photographs takes: the kernel against its plain-torch twin, and whole frames of a run.

Example:
    nmbg train out/fox --output out/fox-photos --preset photos
    python benchmarks/blend.py out/fox-photos --output out/blend
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import numpy as np
import torch
from options import output_option
from record import command, provenance, write
from timing import timed

from nmbg.ops import blend_photos, mip_chain, reference
from nmbg.scene import Scene
from nmbg.sight import look
from nmbg.training.checkpoint import load_run

SIZES = (480, 960, 1920)  # longer side, pixels
CANDIDATES = (1, 7, 14, 28)
REPEATS = 9


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@output_option("JSON and table")
def main(run: Path, output: Path) -> None:
    """Time the blending of RUN's photographs into its first held-out view."""
    loaded = load_run(run)
    photographs = loaded.renderer.photographs
    if photographs is None:
        raise click.ClickException(f"{run}: blends no photographs; give a run of the presets photos or nmbg")
    scene, views = photographs.scene, photographs.views
    held_out = Scene.load(loaded.source).test[0].camera
    results: dict[str, Any] = {
        "command": command(),
        **provenance(),
        "kernel": [],
        "twin": [],
        "frames": [],
    }
    nearest = sorted(views, key=lambda view: -float(view.camera.axis @ held_out.axis))
    chains = [mip_chain(torch.from_numpy(scene.load_image(view))) for view in nearest[: max(CANDIDATES)]]
    depths = [look(scene.mesh, view.camera).depth for view in nearest[: max(CANDIDATES)]]
    for size in SIZES:
        scale = size / max(held_out.width, held_out.height)
        camera = held_out.resized(round(scale * held_out.width), round(scale * held_out.height))
        warps = torch.from_numpy(np.stack([camera.warp_to(v.camera) for v in nearest[: len(chains)]])).float()
        intrinsics = torch.from_numpy(np.stack([v.camera.K for v in nearest[: len(chains)]])).float()
        depth = look(scene.mesh, camera).depth
        for n in CANDIDATES:
            arguments = (
                depth, warps[:n], intrinsics[:n], float(camera.K[0, 0]), chains[:n], depths[:n],
            )  # fmt: skip
            row = {"width": camera.width, "height": camera.height, "candidates": n}
            results["kernel"].append({**row, **timed(partial(blend_photos, *arguments), REPEATS)})
            if size == SIZES[0] and n == 14:
                results["twin"].append({**row, **timed(partial(reference.blend_photos, *arguments), 3)})
                close = (blend_photos(*arguments).colour - reference.blend_photos(*arguments).colour).abs()
                assert (close < 1e-3).float().mean() > 0.99, "kernel and twin disagree"
        if size < SIZES[-1]:
            frame = {"width": camera.width, "height": camera.height, "preset": loaded.config.preset}
            results["frames"].append({**frame, **timed(partial(loaded.renderer.render, camera), REPEATS)})
    write(output, "blend", results, _table(results))
    click.echo(_table(results))


def _table(results: dict[str, Any]) -> str:
    lines = [
        f"{results['machine']}",
        "",
        "| what | size | candidates | ms (quartiles) |",
        "|---|---|---|---|",
    ]
    for kind in ("kernel", "twin", "frames"):
        for row in results[kind]:
            what = row.get("preset", "") + " frame" if kind == "frames" else kind
            lines.append(
                f"| {what} | {row['width']}×{row['height']} | {row.get('candidates', '')} "
                f"| {row['ms']:.1f} ({row['low']:.1f}–{row['high']:.1f}) |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
