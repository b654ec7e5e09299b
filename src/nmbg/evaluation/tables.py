"""Metrics as tables for the terminal."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table
from rich.text import Text

from nmbg.evaluation.results import Report


def metrics_table(report: Report) -> Group:
    """A row per view and the mean, then under what conditions the numbers hold."""
    table = Table(title=f"{report.run}, {report.split} views", title_justify="left")
    table.add_column("view", overflow="fold")
    for name in report.settings:
        table.add_column(name, justify="right")
    for view, values in report.views.items():
        table.add_row(view, *(format_metric(name, values[name]) for name in report.settings))
    table.add_section()
    table.add_row("mean", *(format_metric(name, value) for name, value in report.mean.items()), style="bold")
    notes = [
        *(f"{name}: {settings}" for name, settings in report.settings.items()),
        f"protocol: {report.protocol}",
        f"geometry: {report.geometry}",
        f"colour histograms, distance from the truth in grey levels: {format_colours(report)}",
        "; ".join(f"{what} {value}" for what, value in format_cost(report).items()),
    ]
    return Group(table, *(Text(note) for note in notes))


def format_metric(name: str, value: float) -> str:
    """Two digits after the point for decibels, four for the rest."""
    return f"{value:.2f}" if name == "psnr" else f"{value:.4f}"


def format_colours(report: Report) -> str:
    """Distance of the colour histograms per channel."""
    return ", ".join(f"{name} {value:.2f}" for name, value in report.colours.items())


def format_cost(report: Report) -> dict[str, str]:
    """Time, space and memory, with units; what is not known is left out."""
    costs = {
        "per frame (median)": _with_unit(report.seconds_per_frame, 1000, "ms"),
        "training": _with_unit(report.train_seconds, 1 / 60, "minutes"),
        "trained scene": _with_unit(report.megabytes, 1, "MB"),
        "peak memory": _with_unit(report.peak_memory_gib, 1, "GiB"),
    }
    return {what: told for what, told in costs.items() if told}


def _with_unit(value: float | None, factor: float, unit: str) -> str:
    return "" if value is None else f"{factor * value:.3g} {unit}"
