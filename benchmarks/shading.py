"""Shading beside the time that its bytes need at the bandwidth of a copy, forward and backward.

    python benchmarks/shading.py out/fox [--output benchmarks/results]

The faces and the points of one training view with descriptors of 8 features of degree 2, as the paper's
presets shade them. Bytes are what must be moved once: the rows of the vertices in view, index, weights and
rays of each pixel, and the features. The first rows of the image are checked against the plain torch twin.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import torch
from record import command, provenance, write
from timing import alternate, show
from torch import Tensor

from nmbg.model.config import ModelConfig
from nmbg.model.fragments import LayerFragments, rasterize_layer
from nmbg.ops import reference, shade_faces, shade_points
from nmbg.scene import Scene
from nmbg.training.config import PRESETS

BASES, FEATURES = 9, 8
CHECKED_ROWS = 8
COPIED = 2**26  # floats: far more than the caches hold


def cases(scene: Scene, config: ModelConfig) -> dict[str, tuple[Any, Any, tuple[Tensor, ...], int]]:
    """Per kind of pixel: the op, its twin, its arguments but the coefficients, and their rows in view."""
    camera = scene.train[0].camera
    rays = camera.rays()
    radius = config.radius_px(camera.width, camera.height)
    finest = replace(config, widths=config.widths[:1])
    seen = rasterize_layer(scene.mesh, camera, replace(finest, points=False), radius)
    hit = seen.levels[0]
    faces = (shade_faces, reference.shade_faces, (hit.face, hit.bary, seen.faces, rays), _rows(seen))
    seen = rasterize_layer(scene.mesh, camera, replace(finest, faces=False), radius)
    hit = seen.levels[0]
    points = (shade_points, reference.shade_points, (hit.index, hit.weight, rays), _rows(seen))
    return {"faces": faces, "points": points}  # type: ignore[dict-item]


def _rows(seen: LayerFragments) -> int:
    assert seen.vertices is not None
    return len(seen.vertices)


def measure(op: Any, twin: Any, arguments: tuple[Tensor, ...], rows: int, repeats: int) -> dict[str, Any]:
    """Times of one kind in milliseconds, and the bytes that the forward must move."""
    coeffs = torch.randn(rows, BASES, FEATURES, requires_grad=True)
    # Images are cut; the list of faces, [F, 3], is none.
    part = [a[:CHECKED_ROWS] if a.dim() == 3 or a.shape == arguments[0].shape else a for a in arguments]
    torch.testing.assert_close(op(*part, coeffs), twin(*part, coeffs), rtol=1e-4, atol=1e-4)

    image = op(*arguments, coeffs)
    grad = torch.randn_like(image)
    source, copy = torch.empty(COPIED), torch.empty(COPIED)
    times = alternate(
        {
            "forward": lambda: op(*arguments, coeffs.detach()),
            "backward": lambda: torch.autograd.grad(image, coeffs, grad, retain_graph=True),
            "copy": lambda: copy.copy_(source),
        },
        repeats,
    )
    moved = sum(t.nbytes for t in (coeffs, image, *arguments))
    rate = 2 * source.nbytes / times["copy"]["ms"]
    return {
        "pixels": image[0].numel(),
        "rows": rows,
        "megabytes": moved / 1e6,
        "gigabytes_a_second": rate / 1e6,
        "forward_to_bytes": times["forward"]["ms"] / (moved / rate),
        "backward_to_forward": times["backward"]["ms"] / times["forward"]["ms"],
        **times,
    }


def _table(results: dict[str, Any]) -> str:
    lines = [
        "Median (quartiles), ms; × the time its bytes need at the bandwidth of a copy in the same run.",
        f"{results['machine']['cpu']}, {results['machine']['threads']} threads; 8 features of degree 2.",
        "",
        "| pixels of | MB | copy, GB/s | forward | × bytes | backward | × forward |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, row in results["kinds"].items():
        lines.append(
            f"| {name}, {row['pixels']:,}, {row['rows']:,} vertices | {row['megabytes']:.1f} "
            f"| {row['gigabytes_a_second']:.1f} | {show(row['forward'])} | {row['forward_to_bytes']:.1f} "
            f"| {show(row['backward'])} | {row['backward_to_forward']:.1f} |"
        )
    return "\n".join(lines) + "\n"


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--output", type=click.Path(path_type=Path), default="benchmarks/results", show_default=True)
@click.option("--repeats", type=click.IntRange(min=5), default=41, show_default=True)
def main(scene: Path, output: Path, repeats: int) -> None:
    """Time shading of SCENE's first training view; write shading.json and shading.md."""
    found = cases(Scene.load(scene), replace(PRESETS["paper"].model, layers=1))
    kinds = {name: measure(*case, repeats) for name, case in found.items()}
    results = {"command": command(), **provenance(), "repeats": repeats, "kinds": kinds}
    write(output, "shading", results, _table(results))
    click.echo(_table(results))


if __name__ == "__main__":
    main()
