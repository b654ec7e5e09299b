"""Render the views of a run that were held out, and measure them."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor

from nmbg.errors import NmbgError
from nmbg.evaluation.cost import run_cost
from nmbg.evaluation.judge import judge, views_to_judge
from nmbg.evaluation.machine import machine, peak_memory_gib
from nmbg.evaluation.metrics import make_metrics
from nmbg.evaluation.report import write_report
from nmbg.evaluation.results import Report, write_results
from nmbg.images import Image, to_bytes
from nmbg.scene import Scene, Split, View, evenly
from nmbg.training.checkpoint import Run, load_run
from nmbg.training.left_out import LeftOut, can_leave_out, fit_left_out
from nmbg.training.run_views import load_views


def evaluate(
    run_folder: Path,
    metrics: Sequence[str] = ("psnr", "ssim"),
    lpips_net: str = "alex",
    weights: Path | None = None,
    split: Split = "test",
    device: str = "cpu",
    table: str | None = None,
    at_most: int | None = None,
) -> Report:
    """Render a split's views, measure them, and write results, pictures and report.html into the run folder.

    The pictures are those that `judge` names; for the training split all names end in -train.

    Args:
        run_folder: of `nmbg train`.
        metrics: names of `nmbg.evaluation.METRICS`.
        lpips_net: network of LPIPS: "alex", "vgg" or "squeeze".
        weights: where the user keeps pretrained weights.
        split: which views.
        device: "cpu" or "cuda".
        table: published results to show in the report, a key of TABLES; None: by the scene's name.
        at_most: so many views alone, spread evenly over the split.

    Raises:
        NmbgError: the run, its scene or the weights are not usable, or a view is not finite.
    """
    run = load_run(run_folder, device)
    whole = Scene.load(run.source)
    scene = load_views(run_folder, whole)
    measures = make_metrics(metrics, lpips_net, weights, torch.device(device))
    views = views_to_judge(scene, measures, split)
    views = tuple(evenly(views, at_most or len(views)))
    show = _shows(run, scene, split)
    show(views[0])  # the first frame also pays for allocations
    seconds: dict[str, float] = {}

    def render(view: View) -> Image:
        start = time.perf_counter()
        image = show(view)
        seconds[view.name] = time.perf_counter() - start
        return _checked(image, view)

    judged = judge(run_folder, scene, views, split, measures, render)
    report = Report(
        run=run_folder.resolve().name,
        preset=run.config.preset,
        views={name: {**values, "seconds": seconds[name]} for name, values in judged.pop("views").items()},
        seconds_per_frame=statistics.median(seconds.values()),
        peak_memory_gib=peak_memory_gib(),
        machine=machine(device),
        **run_cost(run_folder),
        **judged,
    )
    write_results(run_folder, report)
    write_report(run_folder, report, whole, run, table)
    return report


def _shows(run: Run, scene: Scene, split: Split) -> Callable[[View], Tensor]:
    """How views are rendered: without their own photograph; under a network, no colour was fitted to it."""
    renderer = run.renderer
    if split == "train" and run.config.exposure:
        return lambda view: renderer.render(view.camera)  # exposed as it was trained
    if split == "test" or not can_leave_out(run.config):
        # What is timed is a frame, and not the reading of what it is blended from.
        if renderer.photographs is not None:
            renderer.photographs.prepare()
        return lambda view: renderer.render(view.camera, without={view.name})
    left_out = LeftOut(renderer, fit_left_out(renderer, scene))

    @torch.no_grad()
    def show(view: View) -> Tensor:
        image: Tensor = renderer(left_out.see(view.camera, view), view.camera)
        return image.clamp(0, 1).cpu()

    return show


def _checked(render: Tensor, view: View) -> Image:
    """[3, H, W] in [0, 1] → [H, W, 3] uint8."""
    if not bool(torch.isfinite(render).all()):
        raise NmbgError(f"{view.name}: the render holds values that are not finite; train the run anew")
    return to_bytes(render)
