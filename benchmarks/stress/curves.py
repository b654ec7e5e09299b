"""From points to curves: where a method has lost 3 dB, the table, the picture, and the sheets."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from nmbg.atomic import atomic_file
from nmbg.evaluation.charts import Axis, Series, chart, figure
from nmbg.evaluation.figures import Row, sheet
from nmbg.images import Image, read_image, resize, write_image
from nmbg.scene import Scene
from stress import STRESSES
from stress.rendering import RENDERINGS
from stress.scenes import file_name

LOSS = 3.0  # dB
WIDTH = 180  # of a picture on a sheet, pixels
COLUMNS, SIZE = 4, (320, 240)  # of charts
UNITS = {stress.name: stress.unit for stress in (*STRESSES.values(), *RENDERINGS)}


def breaking_point(points: Sequence[dict[str, Any]]) -> float | None:
    """Severity at which 3 dB of PSNR are lost, between the measured ones linearly; None where they are not.

    Args:
        points: by severity, the first without stress; those without a loss are passed over.
    """
    known = [(p["severity"], p["loss"]) for p in points if p["loss"] is not None]
    for (low, before), (high, after) in pairwise(known):
        if after >= LOSS:
            return float(low + (high - low) * (LOSS - before) / (after - before))
    return None


def broken(points: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The first measured point that has lost 3 dB; else the last."""
    return next((p for p in points if p["loss"] is not None and p["loss"] >= LOSS), points[-1])


def table(results: dict[str, Any]) -> str:
    """Breaking points, then every curve, then what was rendered."""
    curves = {name: curve for name, curve in results["curves"].items() if curve}
    presets = list(dict.fromkeys(preset for curve in curves.values() for preset in curve))
    head = f"| stress | severity | {' | '.join(presets)} |"
    rule = "|---|---|" + "---|" * len(presets)
    lines = [
        f"Scene {results['scene']}. Severity at which {LOSS:g} dB of PSNR are lost; > where the worst that "
        "was measured loses less, – where nothing was measured.",
        "",
        head,
        rule,
    ]
    for name, curve in curves.items():
        cells = [_breaking(curve.get(preset, [])) for preset in presets]
        lines.append(f"| {name} | {UNITS[name]} | {' | '.join(cells)} |")
    lines += [
        "",
        "What is lost of the PSNR of held-out views, dB, by severity; first the PSNR without stress.",
        "",
    ]
    lines += [head, rule]
    for name, curve in curves.items():
        shown = [_listed(curve.get(preset, [])) for preset in presets]
        scale = " / ".join(f"{point['severity']:g}" for point in max(curve.values(), key=len))
        lines.append(f"| {name} | {scale} | {' | '.join(shown)} |")
    if results["rendered"]:
        lines += [
            "",
            "| preset | random cameras | bad | largest range, looking away | flicker, mean (least), dB |",
        ]
        lines += ["|---|---|---|---|---|"]
        for preset, row in results["rendered"].items():
            away, soak, flicker = row["away"], row["soak"], row["flicker"]
            spread = f"{max(away['ranges'].values()):.3f}" if away else "–"
            steps = f"{flicker['mean']:.2f} ({flicker['least']:.2f})" if flicker else "–"
            random = f"{soak['cameras']} | {soak['bad']}" if soak else "– | –"
            lines.append(f"| {preset} | {random} | {spread} | {steps} |")
    if results["seeds"]:
        lines += ["", "| preset | PSNR of seeds | range |", "|---|---|---|"]
        for preset, values in results["seeds"].items():
            shown = " / ".join(f"{value:.2f}" for value in values)
            lines.append(f"| {preset} | {shown} | {max(values) - min(values):.2f} |")
    if results["failed"]:
        lines += ["", *(f"- {key}: {why}" for key, why in results["failed"].items())]
    return "\n".join(lines) + "\n"


def _breaking(points: Sequence[dict[str, Any]]) -> str:
    if len(points) < 2:
        return "–"
    at = breaking_point(points)
    known = [p["severity"] for p in points if p["loss"] is not None]
    return f"> {known[-1]:g}" if at is None else f"{at:.3g}"


def _listed(points: Sequence[dict[str, Any]]) -> str:
    losses = ["–" if p["loss"] is None else f"{p['loss']:.2f}" for p in points[1:]]
    return " / ".join([f"{points[0]['psnr']:.2f}", *losses]) if points else "–"


def draw(results: dict[str, Any]) -> str:
    """All curves, one chart a stress; severities evenly, as they are no common scale."""
    curves = {name: curve for name, curve in results["curves"].items() if curve}
    presets = list(dict.fromkeys(preset for curve in curves.values() for preset in curve))
    charts = []
    for name, curve in curves.items():
        ticks = sorted({p["severity"] for points in curve.values() for p in points})
        series = [Series(preset, _places(curve.get(preset, []), ticks)) for preset in presets]
        across = Axis(UNITS[name], names=tuple(f"{tick:g}" for tick in ticks))
        charts.append(chart(series, across, Axis("PSNR, dB"), name, SIZE))
    return figure(charts, [Series(preset, []) for preset in presets], COLUMNS, SIZE)


def _places(points: Sequence[dict[str, Any]], ticks: list[float]) -> list[tuple[float, float]]:
    return [
        (float(ticks.index(p["severity"])), points[0]["psnr"] - p["loss"])
        for p in points
        if p["loss"] is not None
    ]


def pictures(results: dict[str, Any], scene: Scene, output: Path) -> None:
    """A sheet for each stress: each preset without it, and at the first severity that costs 3 dB.

    Presets whose pictures are not there are left out.
    """
    middle = scene.load_image(scene.test[len(scene.test) // 2])
    for name, curve in results["curves"].items():
        rows = []
        for preset, points in curve.items():
            worst = broken(points)
            shots = [output / point["picture"] for point in (points[0], worst)]
            if not all(shot.exists() for shot in shots):
                continue
            panels = [*map(read_image, shots), middle]
            shown = "–" if worst["psnr"] is None else f"{worst['psnr']:.2f} dB"
            told = f"{preset}: {worst['severity']:g} ({UNITS[name]}), {shown}"
            rows.append(Row(told, tuple(_fitted(panels))))
        if rows:
            path = output / "sheets" / f"{results['scene']}-{file_name(name)}.png"
            with atomic_file(path) as temporary:
                write_image(temporary, sheet(rows, ("without", "with", "photograph"), errors=False))


def _fitted(panels: Sequence[Image]) -> list[Image]:
    """Pictures of one size, black around those of another shape."""
    height = round(WIDTH * panels[-1].shape[0] / panels[-1].shape[1])
    fitted = []
    for panel in panels:
        scale = min(WIDTH / panel.shape[1], height / panel.shape[0])
        small = resize(panel, max(1, round(scale * panel.shape[1])), max(1, round(scale * panel.shape[0])))
        canvas = np.zeros((height, WIDTH, 3), np.uint8)
        canvas[: small.shape[0], : small.shape[1]] = small[:height, :WIDTH]
        fitted.append(canvas)
    return fitted
