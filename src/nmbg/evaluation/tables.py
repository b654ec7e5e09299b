"""Metrics as tables for the terminal."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table
from rich.text import Text

from nmbg.evaluation.evaluate import Report


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
    memory = "" if report.peak_memory_gib is None else f", peak memory {report.peak_memory_gib:.2f} GiB"
    notes = [
        *(f"{name}: {settings}" for name, settings in report.settings.items()),
        f"protocol: {report.protocol}",
        f"geometry: {report.geometry}",
        f"{report.seconds_per_frame:.3f} s per frame (median){memory}",
    ]
    return Group(table, *(Text(note) for note in notes))


def format_metric(name: str, value: float) -> str:
    """Two digits after the point for decibels, four for the rest."""
    return f"{value:.2f}" if name == "psnr" else f"{value:.4f}"
