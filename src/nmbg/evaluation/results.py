"""What was measured, and how: metrics.json."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from nmbg.atomic import atomic_file
from nmbg.errors import NmbgError
from nmbg.images import Image, read_image
from nmbg.scene import Split


@dataclass(frozen=True)
class Report:
    """What was measured, and how.

    Args:
        run: name of the run folder, or the label of another program's renders.
        scene: name of the scene folder.
        split: "test" (held out) or "train".
        preset: of the run; None for another program's renders.
        nmbg: version of the program.
        settings: per metric, what its number depends on.
        protocol: how images were prepared and values averaged.
        geometry: where the geometry came from.
        mean: per metric, the mean over the views.
        views: per view, its metrics, and the seconds it took to render where that was measured here.
        renders: per view, its picture below renders/, without suffix; the photograph's ends in .target.
        colours: per channel, distance between the colour histograms of renders and photographs, grey levels.
        seconds_per_frame: median over the views, after one frame to warm up; None where it is not known.
        train_seconds: time to train; None where it is not known.
        megabytes: what rendering reads from disk, 10⁶ bytes; None where it is not known.
        peak_memory_gib: of this process, GiB; None where it is not known.
        machine: where it ran.
    """

    run: str
    scene: str
    split: Split
    preset: str | None
    nmbg: str
    settings: dict[str, str]
    protocol: str
    geometry: str
    mean: dict[str, float]
    views: dict[str, dict[str, float]]
    renders: dict[str, str]
    colours: dict[str, float]
    seconds_per_frame: float | None
    train_seconds: float | None
    megabytes: float | None
    peak_memory_gib: float | None
    machine: dict[str, str | int]


def result_suffix(split: Split) -> str:
    """What the names of a split's results end in."""
    return "" if split == "test" else f"-{split}"


def write_results(folder: Path, report: Report) -> None:
    """Write metrics.json, or metrics-train.json, into a folder."""
    with atomic_file(_path(folder, report.split)) as file:
        file.write_text(json.dumps(_plain(asdict(report)), indent=1, allow_nan=False) + "\n")


def read_results(folder: Path, split: Split = "test") -> Report:
    """Read what `write_results` wrote.

    Raises:
        NmbgError: there is nothing, or it is damaged or of another version.
    """
    path = _path(folder, split)
    if not path.is_file():
        raise NmbgError(f"{folder}: not evaluated yet (no {path.name}); run nmbg eval on it first")
    try:
        report = Report(**json.loads(path.read_text()))
        return Report(**{**vars(report), "mean": _infinite(report.mean), "views": _infinite(report.views)})
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise NmbgError(f"{path}: damaged or of another version; run nmbg eval again") from error


def read_pair(folder: Path, report: Report, view: str) -> tuple[Image, Image]:
    """Render and photograph of a view, [H, W, 3] uint8, masked as they were judged.

    Args:
        folder: of the result.
        report: what was measured.
        view: name of the view.
    """
    base = folder / f"renders{result_suffix(report.split)}" / report.renders[view]
    return read_image(base.with_name(f"{base.name}.png")), read_image(
        base.with_name(f"{base.name}.target.png")
    )


def _path(folder: Path, split: Split) -> Path:
    return folder / f"metrics{result_suffix(split)}.json"


def _plain(value: Any) -> Any:
    """JSON knows no infinity, which is the PSNR of identical images: null stands for it."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isinf(value) else value


def _infinite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _infinite(item) for key, item in value.items()}
    return math.inf if value is None else value
