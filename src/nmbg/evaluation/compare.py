"""Several results side by side, in the terminal and on a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from nmbg.atomic import atomic_file
from nmbg.errors import NmbgError
from nmbg.evaluation import higher_is_better
from nmbg.evaluation import page as html
from nmbg.evaluation.charts import Axis, Series, chart, figure
from nmbg.evaluation.results import Report, read_pair, read_results
from nmbg.evaluation.tables import format_metric
from nmbg.scene import Split

DISPUTED = 4  # views whose pictures are shown: those on which the results differ most
COSTS = {
    "minutes": ("train_seconds", 1 / 60),
    "ms / frame": ("seconds_per_frame", 1000.0),
    "MB": ("megabytes", 1.0),
}
_SIZE = (400, 260)  # of a chart, pixels


@dataclass(frozen=True)
class Result:
    """One of the results that are compared: its folder, what it is called here, and what was measured."""

    folder: Path
    label: str
    report: Report


def read_all(folders: Sequence[Path], split: Split = "test") -> list[Result]:
    """Read what `nmbg eval` wrote into several folders.

    Results of one name are called by their folders.

    Raises:
        NmbgError: a folder holds no result, or no metric is common to all.
    """
    reports = [read_results(folder, split) for folder in folders]
    names = Counter(report.run for report in reports)
    results = [
        Result(folder, report.run if names[report.run] == 1 else str(folder), report)
        for folder, report in zip(folders, reports, strict=True)
    ]
    if not common_metrics(results):
        raise NmbgError(f"{folders[0]}, …: no metric was measured on all; run nmbg eval with equal --metrics")
    return results


def common_metrics(results: Sequence[Result]) -> list[str]:
    """The metrics that all results have, in the order of the first."""
    return [name for name in results[0].report.mean if all(name in r.report.mean for r in results)]


def comparison_table(results: Sequence[Result]) -> Group:
    """A row per result, the best of each column in bold; then what keeps the numbers from being compared."""
    head, rows, best = _rows(results)
    table = Table(title_justify="left")
    table.add_column(head[0], overflow="fold")
    for name in head[1:]:
        table.add_column(name, justify="right")
    for r, row in enumerate(rows):
        table.add_row(*(Text(cell, "bold" if best.get(c) == r else "") for c, cell in enumerate(row)))
    return Group(table, *map(Text, disagreements(results)))


def disagreements(results: Sequence[Result]) -> list[str]:
    """What differs between the results besides who rendered, in words."""
    first = results[0].report
    told = []
    for what in ("scene", "protocol", "geometry"):
        values = list(dict.fromkeys(getattr(r.report, what) for r in results))
        if len(values) > 1:
            told.append(f"{what} differs: {'; '.join(values)}")
    told += [
        f"settings of {name} differ"
        for name in common_metrics(results)
        if any(r.report.settings[name] != first.settings[name] for r in results)
    ]
    if any(set(r.report.views) != set(first.views) for r in results):
        told.append(f"views differ: {', '.join(f'{len(r.report.views)} of {r.label}' for r in results)}")
    if len({tuple(r.report.machine[key] for key in ("cpu", "threads", "device")) for r in results}) > 1:
        told.append("machines differ: compare no times")
    if any(r.report.preset is None for r in results):
        told.append("times and sizes of other programs' renders are as their user told them")
    return told


def write_comparison(path: Path, results: Sequence[Result]) -> None:
    """Write the page.

    Args:
        path: HTML file.
        results: of `read_all`.
    """
    head, rows, best = _rows(results)
    whole = html.page(
        " · ".join(result.label for result in results),
        html.section("Means", html.table(head, rows, best=best), html.listing(disagreements(results))),
        _costs(results),
        _pictures(results),
        _per_view(results),
    )
    with atomic_file(path) as file:
        file.write_text(whole, encoding="utf-8")


def _rows(results: Sequence[Result]) -> tuple[list[str], list[list[str]], dict[int, int]]:
    """Headings, cells, and of each column the row that is best."""
    metrics = common_metrics(results)
    columns: list[tuple[Sequence[float | None], bool]] = [
        ([r.report.mean[name] for r in results], higher_is_better(name)) for name in metrics
    ]
    columns += [([cost(r.report, name) for r in results], False) for name in COSTS]
    rows = [
        [
            result.label,
            *(format_metric(name, result.report.mean[name]) for name in metrics),
            *("" if value is None else f"{value:.3g}" for value in (cost(result.report, c) for c in COSTS)),
        ]
        for result in results
    ]
    best = {}
    for c, (values, higher) in enumerate(columns, start=1):
        known = {r: value for r, value in enumerate(values) if value is not None}
        if len(known) > 1:
            best[c] = (max if higher else min)(known, key=lambda r: known[r])
    return ["result", *metrics, *COSTS], rows, best


def cost(report: Report, name: str) -> float | None:
    """A cost by its name in COSTS, in the unit of that name; None where it is not known."""
    attribute, factor = COSTS[name]
    value: float | None = getattr(report, attribute)
    return None if value is None else factor * value


def _costs(results: Sequence[Result]) -> str:
    """Charts of every metric against every cost."""
    charts, series = [], []
    for metric in common_metrics(results):
        for name in COSTS:
            points = [(cost(r.report, name), r.report.mean[metric]) for r in results]
            series = [
                Series(r.label, [(x, y)] if x is not None else [], line=False)
                for r, (x, y) in zip(results, points, strict=True)
            ]
            charts.append(chart(series, Axis(name), Axis(metric), size=_SIZE))
    return html.section("Against what it costs", figure(charts, series, len(COSTS), _SIZE))


def _common_views(results: Sequence[Result], metric: str) -> list[str]:
    """The views that all judged, those on which a metric differs most first; none of different scenes."""
    if len({r.report.scene for r in results}) > 1:
        return []
    names = [name for name in results[0].report.views if all(name in r.report.views for r in results)]

    def spread(view: str) -> float:
        values = [r.report.views[view][metric] for r in results]
        return max(values) - min(values) if min(values) < max(values) else 0.0

    return sorted(names, key=spread, reverse=True)


def _pictures(results: Sequence[Result]) -> str:
    metric = common_metrics(results)[0]
    rows = []
    for view in _common_views(results, metric)[:DISPUTED]:
        pairs = [read_pair(r.folder, r.report, view) for r in results]
        items = [(f"{view}: photograph", pairs[0][1])]
        for result, (render, _) in zip(results, pairs, strict=True):
            value = format_metric(metric, result.report.views[view][metric])
            items.append((f"{result.label}: {metric} {value}", render))
        rows.append(html.pictures(items, 380))
    return html.section("Where they differ most", *rows) if rows else ""


def _per_view(results: Sequence[Result]) -> str:
    metric = common_metrics(results)[0]
    rows = [
        [view, *(format_metric(metric, r.report.views[view][metric]) for r in results)]
        for view in _common_views(results, metric)
    ]
    head = ["view", *(r.label for r in results)]
    return html.section(f"{metric} per view", html.table(head, rows)) if rows else ""
