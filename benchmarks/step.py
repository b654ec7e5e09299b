"""Where the milliseconds of a training step go, and what they grow with.

    python benchmarks/step.py out/fox --weights DIR [--preset split] [--output benchmarks/results]

Whole frames of a few training views, all of them seen before: fragments and targets' features are kept, as
they are in training. The parts of a step are read from torch's profiler; convolutions stand beside the
convolution that the machine does best, in the same run. Then the same in bfloat16, with every face cut into
sixteen, with four times the views, and with half the sides.
"""

from __future__ import annotations

import itertools
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import numpy as np
import torch
import trimesh
from record import command, provenance, write
from smaller import smaller_scene
from timing import quartiles
from torch import nn
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from nmbg.mesh import Mesh
from nmbg.scene import Scene
from nmbg.training import checkpoint, loop, member
from nmbg.training.config import PRESETS, TrainConfig
from nmbg.training.optimiser import descend, descriptors_part, differentiate, network_part
from nmbg.training.start import mean_colours
from nmbg.training.trainer import make_perceptual

VIEWS = 4
PARTS = {
    "nmbg::shade": "shading",
    "nmbg::shade_backward_coeffs": "shading, backward",
    "Optimizer.step#RowAdam.step": "descriptors' Adam",
    "Optimizer.step#Adam.step": "network's Adam",
    "aten::convolution": "convolutions",
    "aten::convolution_backward": "convolutions, backward",
}


class Steps:
    """A scene and a preset, ready to be trained on for a few steps."""

    def __init__(self, scene: Scene, config: TrainConfig, weights: Path | None) -> None:
        self.config, self.renderer = config, checkpoint.build_renderer(scene, config)
        self.renderer.set_colours(mean_colours(self.renderer.layers))
        self.renderer.train()
        self.perceptual = make_perceptual(config, weights, None)
        self.views, _ = member.make_views(scene, config, self.renderer, None, None)
        self.stage = config.stages[-1]
        self.parts = [
            *network_part(self.renderer.network, self.stage),
            *descriptors_part(self.renderer, self.stage),
        ]
        self.number = 0

    def step(self) -> None:
        """One step, as training does it."""
        example = self.views.frame(self.number % len(self.views))
        generator = torch.Generator().manual_seed(self.number)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.config.bf16):
            image = loop.as_photographed(loop.render(self.renderer, self.stage, example)[None], example)
            loss = loop.losses(image, self.stage, self.perceptual, None, example, generator)["loss"]
        assert differentiate(loss, self.parts)
        descend(self.parts, 0.9)
        self.number += 1


def subdivided(mesh: Mesh, times: int) -> Mesh:
    """Every face cut into four, some times; colours at the mean."""
    vertices, faces, colours = mesh.vertices, mesh.faces, mesh.colours.astype(np.float64)
    for _ in range(times):
        both = np.concatenate([vertices, colours], 1)
        both, faces = trimesh.remesh.subdivide(both, faces)
        vertices, colours = both[:, :3], both[:, 3:]
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), colours.round().astype(np.uint8))


def measure(steps: Steps, repeats: int) -> dict[str, Any]:
    """Times of a step and of its parts, milliseconds."""
    for _ in range(len(steps.views)):
        steps.step()
    seconds = [_timed(steps.step) for _ in range(repeats)]
    with FlopCounterMode(display=False) as counter:
        steps.step()
    with profile(activities=[ProfilerActivity.CPU]) as profiled:
        for _ in range(len(steps.views)):
            steps.step()
    events = {event.key: event.cpu_time_total / 1000 / len(steps.views) for event in profiled.key_averages()}
    parts = {name: events.get(key, 0.0) for key, name in PARTS.items()}
    vertices = [len(mesh.vertices) for mesh in steps.renderer.layers]
    rasterizing = [_timed(lambda v=view: steps.views.see(v.camera, v)) for view in steps.views.views]
    return {
        "vertices": sum(vertices),
        "step": quartiles(seconds),
        "parts": parts,
        "rasterizing, once a view": quartiles(rasterizing),
        "gflop": counter.get_total_flops() / 1e9,
    }


def _timed(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def convolution_ceiling() -> dict[str, float]:
    """Billions of operations a second of a 3 × 3 convolution 64 → 64 at 270 × 480, per type and layout."""
    found = {}
    for dtype, layout in itertools.product(
        (torch.float32, torch.bfloat16), (torch.contiguous_format, torch.channels_last)
    ):
        convolution = nn.Conv2d(64, 64, 3, padding=1).to(dtype).to(memory_format=layout)
        x = torch.randn(1, 64, 270, 480).to(dtype).contiguous(memory_format=layout)
        with torch.no_grad():
            convolution(x)
            best = min(_timed(lambda c=convolution, x=x: c(x)) for _ in range(15))
        found[f"{dtype}, {layout}".replace("torch.", "")] = 2 * 9 * 64 * 64 * 270 * 480 / best / 1e9
    return found


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--weights", type=click.Path(path_type=Path), help="Folder with VGG-19's weights.")
@click.option("--preset", type=click.Choice(list(PRESETS)), default="split", show_default=True)
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("benchmarks/results"), show_default=True
)
@click.option("--repeats", type=click.IntRange(min=5), default=9, show_default=True)
def main(scene: Path, weights: Path | None, preset: str, output: Path, repeats: int) -> None:
    """Measure a training step and its parts.

    Example: python benchmarks/step.py out/fox --weights weights
    """
    whole = Scene.load(scene)
    few = replace(whole, views=whole.train[:VIEWS])
    config = replace(PRESETS[preset], iterations=1000, minutes=None, refine="none")
    results: dict[str, Any] = {"command": command(), **provenance(), "preset": preset}
    results["convolution ceiling, GFLOP/s"] = convolution_ceiling()
    cases = {
        "as it is": (few, config),
        "bfloat16": (few, replace(config, bf16=True)),
        "faces × 16": (replace(few, mesh=subdivided(few.mesh, 2)), config),
        "views × 4": (replace(whole, views=whole.train[: 4 * VIEWS]), config),
    }
    results["cases"] = {}
    with tempfile.TemporaryDirectory() as folder:
        half = Scene.load(smaller_scene(scene, Path(folder), images=0.5))
        cases["half the sides"] = replace(half, views=half.train[:VIEWS]), config
        for name, (of, setting) in cases.items():
            results["cases"][name] = measure(Steps(of, setting, weights), repeats)
            click.echo(f"{name}: {results['cases'][name]}")
    write(output, "step", results, _table(results))


def _table(results: dict[str, Any]) -> str:
    cases = results["cases"]
    names = list(next(iter(cases.values()))["parts"])
    ceiling = max(results["convolution ceiling, GFLOP/s"].values())
    lines = [
        f"A training step of preset {results['preset']}, milliseconds. {results['machine']}",
        "",
        "| | " + " | ".join(cases) + " |",
        "|---" * (1 + len(cases)) + "|",
        "| vertices | " + " | ".join(f"{case['vertices']:,}" for case in cases.values()) + " |",
        "| step, median | " + " | ".join(f"{case['step']['ms']:.0f}" for case in cases.values()) + " |",
    ]
    for name in names:
        lines += [f"| {name} | " + " | ".join(f"{case['parts'][name]:.1f}" for case in cases.values()) + " |"]
    once = "rasterizing, once a view"
    lines.append(f"| {once} | " + " | ".join(f"{case[once]['ms']:.1f}" for case in cases.values()) + " |")
    rates = []
    for case in cases.values():
        spent = case["parts"]["convolutions"] + case["parts"]["convolutions, backward"]
        rates.append(f"{case['gflop'] / spent * 1000:.0f}")
    lines.append("| convolutions, GFLOP/s | " + " | ".join(rates) + " |")
    lines += ["", f"Convolutions 64 → 64 at 270 × 480 alone reach {ceiling:.0f} GFLOP/s in the same run:", ""]
    lines += [f"- {name}: {rate:.0f}" for name, rate in results["convolution ceiling, GFLOP/s"].items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
