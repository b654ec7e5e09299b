"""report.html: everything about one result on a page that holds all it shows."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from nmbg.atomic import atomic_file
from nmbg.evaluation import higher_is_better
from nmbg.evaluation import page as html
from nmbg.evaluation.charts import Axis, Series, chart, figure
from nmbg.evaluation.features import feature_panels
from nmbg.evaluation.figures import ERROR_RANGE, error_map
from nmbg.evaluation.histograms import CHANNELS, read_histograms
from nmbg.evaluation.published import TABLES, differences, our_rows, recognise
from nmbg.evaluation.results import Report, read_pair, result_suffix
from nmbg.evaluation.tables import format_cost, format_metric
from nmbg.scene import Scene, View
from nmbg.training.checkpoint import CONFIG, Run

EXTREMES = 3  # best and worst views that are shown
CURVE_POINTS = 400  # of the training curve
_SIZE = (400, 250)  # of a chart, pixels
_CAPACITY = ("choice", "saves", "costs", "reason")


def write_report(
    folder: Path, report: Report, scene: Scene, run: Run | None = None, table: str | None = None
) -> Path:
    """Write report.html, or report-train.html, beside what `judge` wrote.

    Args:
        folder: holds renders and colours; of a run also its log and config.yaml.
        report: what was measured.
        scene: the whole scene, as it was preprocessed.
        run: what rendered; None for another program's pictures.
        table: published results to compare with, a key of TABLES; None: those of the scene's name, if any.
    """
    views = by_error(report, scene)
    whole = html.page(
        f"{report.run}: {report.scene}",
        html.note(_about(report)),
        _means(report),
        _published(report, scene, table or recognise(scene)),
        _speed(report),
        _capacity(folder),
        _extremes(folder, report, views),
        _per_view(report, views),
        _colours(folder, report),
        _features(run, views[len(views) // 2]) if run else "",
        _training(folder),
    )
    path = folder / f"report{result_suffix(report.split)}.html"
    with atomic_file(path) as file:
        file.write_text(whole, encoding="utf-8")
    return path


def by_error(report: Report, scene: Scene) -> list[View]:
    """The judged views, the worst by the first metric first."""
    name = next(iter(report.settings))
    sign = 1 if higher_is_better(name) else -1
    judged = [view for view in scene.views if view.name in report.views]
    return sorted(judged, key=lambda view: sign * report.views[view.name][name])


def _about(report: Report) -> str:
    system = f"preset {report.preset}" if report.preset else "renders of another program"
    machine = f"{report.machine['cpu']}, {report.machine['threads']} threads, {report.machine['device']}"
    kind = "held-out" if report.split == "test" else "training"
    return f"{system}; {len(report.views)} {kind} views; nmbg {report.nmbg}; {machine}"


def _means(report: Report) -> str:
    rows = [[name, format_metric(name, value), report.settings[name]] for name, value in report.mean.items()]
    notes = (f"Protocol: {report.protocol}.", f"Geometry: {report.geometry}.")
    return html.section(
        "Metrics", html.table(("metric", "mean", "settings"), rows, text=True), *map(html.note, notes)
    )


def _published(report: Report, scene: Scene, name: str | None) -> str:
    """The paper's rows beside ours, and what differs; empty where the scene is none of theirs."""
    if name is None:
        return ""
    table, ours = TABLES[name], our_rows(TABLES[name], report, scene)
    parts = []
    for part in dict.fromkeys([*table.parts, *ours]):
        rows = [[method, *_cells(values[part])] for method, values in table.rows.items() if part in values]
        marked = [len(rows)] if part in ours else []
        rows += [[f"{report.run} (ours)", *_cells(ours[part])]] if part in ours else []
        parts.append(html.table((part, "PSNR", "SSIM (range 2)", "LPIPS (AlexNet) × 100"), rows, ours=marked))
    told = differences(table, name, report, scene)
    return html.section(f"Published: {table.title}", *parts, html.note("What differs:"), html.listing(told))


def _cells(values: Sequence[float | None]) -> list[str]:
    return [
        "" if value is None else f"{value:.{digits}f}"
        for value, digits in zip(values, (2, 3, 2), strict=True)
    ]


def _speed(report: Report) -> str:
    rows = [[what, told] for what, told in format_cost(report).items()]
    if not rows:
        return ""
    if report.preset is None:
        kind = "As told by whoever rendered."
    else:
        kind = (
            "A frame: rasterization included, reading and writing files not. "
            "The scene: what rendering reads from disk."
        )
    return html.section("Speed and size", html.table(("", ""), rows), html.note(kind))


def _capacity(folder: Path) -> str:
    """What the scene's size was decided by, where the run records it."""
    path = folder / CONFIG
    records = yaml.safe_load(path.read_text()).get("choices") if path.is_file() else None
    if not isinstance(records, list) or not records:
        return ""
    rows = [[str(record.get(key, "")) for key in _CAPACITY] for record in records]
    return html.section("Capacity", html.table(_CAPACITY, rows, text=True))


def _extremes(folder: Path, report: Report, views: Sequence[View]) -> str:
    """The worst and the best views; where there are few, every view once."""
    worst = views[:EXTREMES]
    best = views[max(len(worst), len(views) - EXTREMES) :]
    parts = []
    for kind, shown in (("Worst", worst), ("Best", best[::-1])):
        for view in shown:
            render, truth = read_pair(folder, report, view.name)
            told = ", ".join(f"{m} {format_metric(m, report.views[view.name][m])}" for m in report.settings)
            items = [(f"{view.name}: {told}", render), ("photograph", truth)]
            parts.append(html.pictures([*items, ("error", error_map(render, truth))], 380))
        if shown:
            parts.insert(len(parts) - len(shown), f"<h3>{kind}</h3>")
    scale = f"Error: mean absolute difference of the channels, from black at 0 to yellow at {ERROR_RANGE:g}."
    return html.section("Worst and best views", *parts, html.note(scale))


def _per_view(report: Report, views: Sequence[View]) -> str:
    timed = all("seconds" in values for values in report.views.values())
    head = ["view", *report.settings, *(["ms"] if timed else [])]
    rows = []
    for view in views:
        values = report.views[view.name]
        times = [f"{1000 * values['seconds']:.0f}"] if timed else []
        rows.append([view.name, *(format_metric(name, values[name]) for name in report.settings), *times])
    return html.section("Views, worst first", html.table(head, rows))


def _colours(folder: Path, report: Report) -> str:
    """Histograms of all judged pixels (paper, last figure)."""
    counts = read_histograms(folder / f"colours{result_suffix(report.split)}.csv")
    shares = 100 * counts / counts.sum(axis=2, keepdims=True).clip(min=1)
    charts, series = [], []
    for c, (name, distance) in enumerate(report.colours.items()):
        series = [
            Series(kind, list(enumerate(shares[i, c].tolist())), marks=False, dashed=not i, colour=colour)
            for i, (kind, colour) in enumerate((("render", "#d62728"), ("photograph", "#333")))
        ]
        title = f"{name}, distance {distance:.2f}"
        charts.append(chart(series, Axis("value"), Axis("% of pixels"), title, _SIZE))
    told = (
        "Distance: earth mover's, in grey levels of 255; the mean step by which the sorted values of the "
        "renders would move to those of the photographs."
    )
    return html.section("Colours", figure(charts, series, len(CHANNELS), _SIZE), html.note(told))


def _features(run: Run, view: View) -> str:
    """What the model rasterizes of one view (paper, figures 2 and 5)."""
    panels = feature_panels(run.renderer, view.camera, view.name)
    if not panels:
        return ""
    told = (
        f"The finest level of {view.name}, the view of median error. Colours are shown as they are, "
        "descriptors by their three principal components; to the right, where there are any (occupancy)."
    )
    rows = [
        html.pictures([(panel.title, panel.features), (f"{panel.title}: occupancy", panel.occupancy)])
        for panel in panels
    ]
    return html.section("Rasterized features", html.note(told), *rows)


def _training(folder: Path) -> str:
    """Loss and validation PSNR by the run's log; empty where nothing was trained."""
    path = folder / "log.csv"
    if not path.is_file():
        return ""
    with path.open(newline="") as file:
        # Views without a photograph have no loss that compares with the others'.
        rows = [row for row in csv.DictReader(file) if row.get("l1") or row.get("perceptual")]
    charts = []
    for column, label, log in (("loss", "loss", True), ("validation_psnr", "validation PSNR, dB", False)):
        points = [(float(row["seconds"]) / 60, float(row[column])) for row in rows if row.get(column)]
        if points:
            kept = np.unique(
                np.linspace(0, len(points) - 1, min(CURVE_POINTS, len(points))).round().astype(int)
            )
            series = Series(label, [points[i] for i in kept], marks=len(kept) < 30)
            charts.append(chart([series], Axis("minutes"), Axis(label, log), label, _SIZE))
    return html.section("Training", figure(charts, [], 2, _SIZE)) if charts else ""
