"""Judge the pictures of any other program by the same measures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import torch

from nmbg.errors import NmbgError
from nmbg.evaluation.judge import judge, render_names, views_to_judge
from nmbg.evaluation.machine import machine
from nmbg.evaluation.metrics import make_metrics
from nmbg.evaluation.report import write_report
from nmbg.evaluation.results import Report, write_results
from nmbg.images import SUFFIXES, image_size, read_image
from nmbg.scene import Scene, Split, View


def evaluate_renders(
    renders: Path,
    scene_folder: Path,
    label: str,
    output: Path,
    metrics: Sequence[str] = ("psnr", "ssim"),
    lpips_net: str = "alex",
    weights: Path | None = None,
    split: Split = "test",
    device: str = "cpu",
    table: str | None = None,
    index: Path | None = None,
    seconds_per_frame: float | None = None,
    train_seconds: float | None = None,
    megabytes: float | None = None,
) -> Report:
    """Measure pictures that some program rendered of a scene's views, and write what `evaluate` writes.

    Args:
        renders: folder with a picture of each view, of its photograph's size; see `find_renders`.
        scene_folder: the scene.
        label: what to call the program.
        output: folder to write.
        metrics: names of `nmbg.evaluation.METRICS`.
        lpips_net: network of LPIPS.
        weights: where the user keeps pretrained weights.
        split: which views.
        device: where LPIPS runs.
        table: published results to show in the report, a key of TABLES; None: by the scene's name.
        index: JSON file, view name → picture in `renders`.
        seconds_per_frame: as the program's user measured it, or None.
        train_seconds: likewise.
        megabytes: what the program's trained scene takes, 10⁶ bytes, or None.

    Raises:
        NmbgError: scene or weights are not usable; a picture is missing, unreadable or of another size.
    """
    scene = Scene.load(scene_folder)
    measures = make_metrics(metrics, lpips_net, weights, torch.device(device))
    views = views_to_judge(scene, measures, split)
    pictures = find_renders(renders, views, index)
    for view in views:
        _check_size(pictures[view.name], view)
    judged = judge(output, scene, views, split, measures, lambda view: read_image(pictures[view.name]))
    report = Report(
        run=label,
        preset=None,
        seconds_per_frame=seconds_per_frame,
        train_seconds=train_seconds,
        megabytes=megabytes,
        peak_memory_gib=None,
        machine=machine(device),
        **judged,
    )
    write_results(output, report)
    write_report(output, report, scene, table=table)
    return report


def find_renders(folder: Path, views: Sequence[View], index: Path | None = None) -> dict[str, Path]:
    """The picture of each view.

    Args:
        folder: where the pictures are.
        views: the views, in the scene's order.
        index: JSON file, view name → picture in `folder`. Without it pictures are called as the photographs
            (subfolders may be left out, suffixes differ), or else as many as there are views are numbered in
            the views' order.

    Returns:
        view name → picture.

    Raises:
        NmbgError: a view has no picture, or several.
    """
    if index is not None:
        return _listed(folder, views, index)
    files = [file for file in sorted(folder.rglob("*")) if file.suffix.lower() in SUFFIXES]
    files = [
        file for file in files if not file.stem.endswith(".target")
    ]  # photographs beside our own renders
    found: Sequence[Path | None] = [_called(name, folder, files) for name in render_names(views)]
    missing = [view.name for view, file in zip(views, found, strict=True) if file is None]
    if missing:
        found = _numbered(files, len(views))
    pictures = {view.name: file for view, file in zip(views, found, strict=False) if file is not None}
    shared = [name for name, file in pictures.items() if list(pictures.values()).count(file) > 1]
    if shared:
        raise NmbgError(
            f"{pictures[shared[0]]} would be the picture of both {shared[0]} and {shared[1]}; put the "
            "pictures into folders named as the photographs', or give --index"
        )
    if len(pictures) < len(views):
        more = f" and {len(missing) - 1} more views" if len(missing) > 1 else ""
        raise NmbgError(
            f"{folder}: no picture of {missing[0]}{more}; name the pictures as the photographs, or number "
            f"all {len(views)} in the views' order, or give --index"
        )
    return pictures


def _called(name: str, folder: Path, files: Sequence[Path]) -> Path | None:
    """The file of a name without suffix, below the folder or in any subfolder."""
    exact = [file for file in files if file.relative_to(folder).with_suffix("").as_posix() == name]
    alike = exact or [file for file in files if file.stem == Path(name).name]
    if len(alike) > 1:
        raise NmbgError(
            f"{alike[0]} and {alike[1]} may both be the picture of {name}; remove one, or give --index"
        )
    return alike[0] if alike else None


def _numbered(files: Sequence[Path], count: int) -> Sequence[Path]:
    """Files named by numbers, in their order, where there are `count` of them; else none."""
    numbered = [file for file in files if file.stem.isdigit()]
    return sorted(numbered, key=lambda file: int(file.stem)) if len(numbered) == count else []


def _listed(folder: Path, views: Sequence[View], index: Path) -> dict[str, Path]:
    try:
        listed = {str(name): folder / file for name, file in json.loads(index.read_text()).items()}
    except (ValueError, TypeError, AttributeError) as error:
        raise NmbgError(f'{index}: expected JSON, {{"view name": "picture", …}}') from error
    for view in views:
        if view.name not in listed:
            raise NmbgError(f"{index}: names no picture of {view.name}; add it")
    return {view.name: listed[view.name] for view in views}


def _check_size(picture: Path, view: View) -> None:
    width, height = image_size(picture)
    if (width, height) != (view.camera.width, view.camera.height):
        raise NmbgError(
            f"{picture}: {width}×{height} pixels, expected {view.camera.width}×{view.camera.height}, the "
            f"size of the photograph {view.name} in the scene; render at that size"
        )
