"""Measure pictures of a scene's views against its photographs, whoever rendered them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nmbg import __version__
from nmbg.atomic import atomic_file, atomic_folder
from nmbg.errors import NmbgError
from nmbg.evaluation.figures import Row, sheet, view_row
from nmbg.evaluation.histograms import CHANNELS, colour_histogram, histogram_distance, write_histograms
from nmbg.evaluation.metrics import Metric
from nmbg.evaluation.results import result_suffix
from nmbg.images import Image, Mask, write_image
from nmbg.progress import progress_bar
from nmbg.scene import Scene, Split, View

SHEET_ROWS = 16
PROTOCOL = "full frames, estimate rounded to 8 bits, mean of the values per view"
MASKED = "; estimate and target multiplied by the mask"


def judge(
    folder: Path,
    scene: Scene,
    views: Sequence[View],
    split: Split,
    measures: Sequence[Metric],
    render: Callable[[View], Image],
) -> dict[str, Any]:
    """Measure pictures of a scene's views, and write into a folder what can be looked at.

    That is renders/ (NAME.png and NAME.target.png, masked where the view has a mask), sheet.png and
    colours.csv.

    Args:
        folder: where to write.
        scene: gives photographs and masks.
        views: those of the split.
        split: "test", or "train": names end in -train.
        measures: the metrics.
        render: view → picture [H, W, 3] uint8.

    Returns:
        the parts of a Report that depend on pictures and scene alone.
    """
    suffix = result_suffix(split)
    shown = set(np.linspace(0, len(views) - 1, min(SHEET_ROWS, len(views))).round().astype(int).tolist())
    names = dict(zip((view.name for view in views), render_names(views), strict=True))
    values: dict[str, dict[str, float]] = {}
    rows: list[Row] = []
    counts = np.zeros((2, 3, 256), dtype=np.int64)
    with atomic_folder(folder / f"renders{suffix}", overwrite=True) as renders, progress_bar() as bar:
        for i, view in enumerate(bar.track(views, description="judging")):
            estimate, target, mask = _masked(scene, view, render(view))
            measured = {m.name: m.compute(_to_tensor(estimate), _to_tensor(target)) for m in measures}
            values[view.name] = measured
            counts += [colour_histogram(image, mask) for image in (estimate, target)]
            _write_pair(renders / names[view.name], estimate, target)
            if i in shown:
                rows.append(view_row(_label(view, measured), estimate, target))
    with atomic_file(folder / f"sheet{suffix}.png") as picture:
        write_image(picture, sheet(rows))
    write_histograms(folder / f"colours{suffix}.csv", counts)
    return {
        "scene": scene.folder.name,
        "split": split,
        "nmbg": __version__,
        "settings": {m.name: m.settings for m in measures},
        "protocol": PROTOCOL + (MASKED if any(view.mask for view in views) else ""),
        "geometry": _geometry(scene),
        "mean": {m.name: statistics.fmean(v[m.name] for v in values.values()) for m in measures},
        "views": values,
        "renders": names,
        "colours": dict(zip(CHANNELS, histogram_distance(*counts).tolist(), strict=True)),
    }


def views_to_judge(scene: Scene, measures: Sequence[Metric], split: Split) -> tuple[View, ...]:
    """The views of a split.

    Raises:
        NmbgError: there are none, or some are too small for a metric.
    """
    views = scene.test if split == "test" else scene.train
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
    return views


def render_names(views: Sequence[View]) -> list[str]:
    """Names for the renders: the photographs'; where those collide or leave the folder, the stored files'."""
    names = [Path(view.name).with_suffix("") for view in views]
    if len(set(names)) < len(names) or any(name.is_absolute() or ".." in name.parts for name in names):
        names = [Path(view.image) for view in views]
    return [name.as_posix() for name in names]


def _to_tensor(image: Image) -> Tensor:
    """[H, W, 3] uint8 → [3, H, W] float64 in [0, 1]."""
    return torch.from_numpy(image).permute(2, 0, 1).double() / 255


def _masked(scene: Scene, view: View, estimate: Image) -> tuple[Image, Image, Mask | None]:
    """Estimate and photograph, black outside the mask, and the mask."""
    target, mask = scene.load_image(view), scene.load_mask(view)
    if mask is None:
        return estimate, target, None
    return estimate * mask[..., None], target * mask[..., None], mask


def _write_pair(base: Path, estimate: Image, target: Image) -> None:
    """Write BASE.png and BASE.target.png; photographs in subfolders keep them."""
    base.parent.mkdir(parents=True, exist_ok=True)
    write_image(base.with_name(f"{base.name}.png"), estimate)
    write_image(base.with_name(f"{base.name}.target.png"), target)


def _label(view: View, measured: dict[str, float]) -> str:
    return "   ".join([view.name, *(f"{name} {value:.4g}" for name, value in measured.items())])


def _geometry(scene: Scene) -> str:
    """Where the geometry came from: a metric means less when it was made with the held-out photographs."""
    file = scene.summary.get("mesh", {}).get("file")
    mesh = Path(file).name if file else "mesh"
    told = "whether it was made with the held-out views is not recorded"
    return f"{scene.source or scene.folder.name}: {mesh}; {told}"
