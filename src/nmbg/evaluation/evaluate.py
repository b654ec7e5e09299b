"""Render the views of a run that were held out, and measure them."""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nmbg import __version__
from nmbg.atomic import atomic_file, atomic_folder
from nmbg.errors import NmbgError
from nmbg.evaluation.figures import Row, sheet, view_row
from nmbg.evaluation.machine import machine, peak_memory_gib
from nmbg.evaluation.metrics import Metric, make_metrics
from nmbg.images import Image, write_image
from nmbg.progress import progress_bar
from nmbg.scene import Scene, Split, View
from nmbg.training.checkpoint import Run, load_run, load_views
from nmbg.training.left_out import LeftOut, can_leave_out, refit_left_out

SHEET_ROWS = 16
PROTOCOL = "full frames, estimate rounded to 8 bits, mean of the values per view"
MASKED = "; estimate and target multiplied by the mask"


@dataclass(frozen=True)
class Report:
    """What was measured, and how.

    Args:
        run: name of the run folder.
        split: "test" (held out) or "train".
        preset: of the run.
        nmbg: version of the program.
        settings: per metric, what its number depends on.
        protocol: how images were prepared and values averaged.
        geometry: where the geometry came from.
        mean: per metric, the mean over the views.
        views: per view, its metrics, and the seconds it took to render.
        seconds_per_frame: median over the views, after one frame to warm up.
        peak_memory_gib: of this process, GiB; None where the system does not tell.
        machine: where it ran.
    """

    run: str
    split: Split
    preset: str
    nmbg: str
    settings: dict[str, str]
    protocol: str
    geometry: str
    mean: dict[str, float]
    views: dict[str, dict[str, float]]
    seconds_per_frame: float
    peak_memory_gib: float | None
    machine: dict[str, str | int]


def evaluate(
    run_folder: Path,
    metrics: Sequence[str] = ("psnr", "ssim"),
    lpips_net: str = "alex",
    weights: Path | None = None,
    split: Split = "test",
    device: str = "cpu",
) -> Report:
    """Render a split's views, measure them, and write metrics, renders and a sheet into the run folder.

    For the test split these are metrics.json, sheet.png and renders/ (NAME.png and NAME.target.png, masked
    where the view has a mask); for the training split metrics-train.json, sheet-train.png and renders-train/.

    Args:
        run_folder: of `nmbg train`.
        metrics: names of `nmbg.evaluation.METRICS`.
        lpips_net: network of LPIPS: "alex", "vgg" or "squeeze".
        weights: where the user keeps pretrained weights.
        split: which views.
        device: "cpu" or "cuda".

    Raises:
        NmbgError: the run, its scene or the weights are not usable, or a view is not finite.
    """
    run = load_run(run_folder, device)
    scene = load_views(run_folder, Scene.load(run.source))
    views = scene.test if split == "test" else scene.train
    measures = make_metrics(metrics, lpips_net, weights, torch.device(device))
    _check(scene, views, measures, split)

    suffix = "" if split == "test" else f"-{split}"
    shown = set(np.linspace(0, len(views) - 1, min(SHEET_ROWS, len(views))).round().astype(int).tolist())
    values: dict[str, dict[str, float]] = {}
    rows: list[Row] = []
    show = _shows(run, scene, split)
    show(views[0])  # the first frame also pays for allocations
    with atomic_folder(run_folder / f"renders{suffix}", overwrite=True) as renders, progress_bar() as bar:
        names = bar.track(_names(views), description="rendering")
        for i, (view, name) in enumerate(zip(views, names, strict=True)):
            start = time.perf_counter()
            render = show(view)
            seconds = time.perf_counter() - start
            estimate, target = _masked(scene, view, _to_bytes(render, view))
            measured = {m.name: m.compute(_to_tensor(estimate), _to_tensor(target)) for m in measures}
            values[view.name] = {**measured, "seconds": seconds}
            _write_pair(renders / name, estimate, target)
            if i in shown:
                rows.append(view_row(_label(view, measured), estimate, target))
    with atomic_file(run_folder / f"sheet{suffix}.png") as picture:
        write_image(picture, sheet(rows))

    report = Report(
        run=run_folder.name,
        split=split,
        preset=run.config.preset,
        nmbg=__version__,
        settings={m.name: m.settings for m in measures},
        protocol=PROTOCOL + (MASKED if any(view.mask for view in views) else ""),
        geometry=_geometry(scene),
        mean={m.name: statistics.fmean(v[m.name] for v in values.values()) for m in measures},
        views=values,
        seconds_per_frame=statistics.median(v["seconds"] for v in values.values()),
        peak_memory_gib=peak_memory_gib(),
        machine=machine(device),
    )
    with atomic_file(run_folder / f"metrics{suffix}.json") as file:
        file.write_text(json.dumps(_plain(asdict(report)), indent=1, allow_nan=False) + "\n")
    return report


def _shows(run: Run, scene: Scene, split: Split) -> Callable[[View], Tensor]:
    """How views are rendered: without their own photograph; under a network, no colour was fitted to it."""
    renderer = run.renderer
    if split == "test" or not can_leave_out(run.config):
        return lambda view: renderer.render(view.camera, without={view.name})
    left_out = LeftOut(renderer, refit_left_out(renderer, scene))

    @torch.no_grad()
    def show(view: View) -> Tensor:
        image: Tensor = renderer(left_out.see(view.camera, view), view.camera)
        return image.clamp(0, 1).cpu()

    return show


def _check(scene: Scene, views: Sequence[View], measures: Sequence[Metric], split: Split) -> None:
    """Refuse before the work starts what would fail in its middle."""
    if not views:
        other = "train" if split == "test" else "test"
        raise NmbgError(f"{scene.folder}: the scene has no {split} views; evaluate with --split {other}")
    for view in views:
        side = min(view.camera.width, view.camera.height)
        for measure in measures:
            if side < measure.smallest:
                raise NmbgError(
                    f"{view.name}: {measure.name} needs images of {measure.smallest} pixels a side, this has "
                    f"{side}; leave the metric out of --metrics"
                )


def _names(views: Sequence[View]) -> list[str]:
    """Names for the renders: the photographs'; where those collide or leave the folder, the stored files'."""
    names = [Path(view.name).with_suffix("") for view in views]
    if len(set(names)) < len(names) or any(name.is_absolute() or ".." in name.parts for name in names):
        names = [Path(view.image) for view in views]
    return [name.as_posix() for name in names]


def _to_bytes(render: Tensor, view: View) -> Image:
    """[3, H, W] in [0, 1] → [H, W, 3] uint8."""
    if not bool(torch.isfinite(render).all()):
        raise NmbgError(f"{view.name}: the render holds values that are not finite; train the run anew")
    return (render.permute(1, 2, 0).clamp(0, 1) * 255).round().to(torch.uint8).contiguous().numpy()


def _to_tensor(image: Image) -> Tensor:
    """[H, W, 3] uint8 → [3, H, W] float64 in [0, 1]."""
    return torch.from_numpy(image).permute(2, 0, 1).double() / 255


def _masked(scene: Scene, view: View, estimate: Image) -> tuple[Image, Image]:
    """Estimate and photograph, black outside the mask."""
    target, mask = scene.load_image(view), scene.load_mask(view)
    if mask is None:
        return estimate, target
    return estimate * mask[..., None], target * mask[..., None]


def _write_pair(base: Path, estimate: Image, target: Image) -> None:
    """Write BASE.png and BASE.target.png; photographs in subfolders keep them."""
    base.parent.mkdir(parents=True, exist_ok=True)
    write_image(base.with_name(f"{base.name}.png"), estimate)
    write_image(base.with_name(f"{base.name}.target.png"), target)


def _label(view: View, measured: dict[str, float]) -> str:
    return "   ".join([view.name, *(f"{name} {value:.4g}" for name, value in measured.items())])


def _geometry(scene: Scene) -> str:
    """Where the geometry came from: a metric means less when it was made with the held-out photographs."""
    told = scene.summary.get("geometry", "whether it was made with the held-out views is not recorded")
    return f"{scene.source or scene.folder.name}: {told}"


def _plain(value: Any) -> Any:
    """JSON knows no infinity, which is the PSNR of identical images: null stands for it."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isinf(value) else value
