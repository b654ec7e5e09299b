"""Line charts as SVG, for pages and folders: no plotting library, the same picture everywhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import cycle

COLOURS = (
    *("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd"),
    *("#8c564b", "#e377c2", "#17becf", "#7f7f7f", "#bcbd22"),
)
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 26, 40  # margins around what is plotted, pixels
_LEGEND_ROW, _CHARACTER = 18, 7.2  # height of a row and width of a letter of the legend, pixels
_GRID, _INK = "#e4e4e4", "#333"
_FONT = 'font-family="DejaVu Sans, Liberation Sans, Arial, sans-serif" font-size="12"'

Points = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Series:
    """What one colour shows.

    Args:
        name: in the legend; empty: not there.
        points: (x, y), in the order in which they are joined.
        line: join the points.
        marks: mark every point; its place is told when the pointer rests on it.
        dashed: break the line.
        colour: any of SVG; None: the next of COLOURS.
        shape: of the marks: 0 circle, 1 square, 2 triangle, 3 diamond.
    """

    name: str
    points: Points
    line: bool = True
    marks: bool = True
    dashed: bool = False
    colour: str | None = None
    shape: int = 0


@dataclass(frozen=True)
class Axis:
    """One axis.

    Args:
        label: what it shows, with its unit.
        log: whether equal steps are equal factors.
        names: what 0, 1, 2, … stand for, where they are no numbers.
    """

    label: str
    log: bool = False
    names: tuple[str, ...] = ()


def chart(
    series: Sequence[Series], x: Axis, y: Axis, title: str = "", size: tuple[int, int] = (420, 280)
) -> str:
    """One chart, an <svg> element without a legend.

    Args:
        series: what is plotted; points that are not finite, or not positive on a logarithmic axis, are left
            out.
        x: the horizontal axis.
        y: the vertical axis.
        title: above the chart.
        size: width and height, pixels.
    """
    width, height = size
    kept = [[p for p in s.points if _fits(p[0], x) and _fits(p[1], y)] for s in series]
    across = _Scale([p[0] for points in kept for p in points], x, _LEFT, width - _RIGHT)
    up = _Scale([p[1] for points in kept for p in points], y, height - _BOTTOM, _TOP)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" {_FONT}>',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="{_LEFT}" y="16" fill="{_INK}" font-weight="bold">{escape(title)}</text>',
    ]
    for value, label in across.ticks():
        at = f"{across(value):.1f}"
        parts.append(f'<path d="M{at} {_TOP}V{height - _BOTTOM}" stroke="{_GRID}"/>')
        parts.append(_text(at, height - _BOTTOM + 16, label, "middle"))
    for value, label in up.ticks():
        at = f"{up(value):.1f}"
        parts.append(f'<path d="M{_LEFT} {at}H{width - _RIGHT}" stroke="{_GRID}"/>')
        parts.append(_text(_LEFT - 6, f"{up(value) + 4:.1f}", label, "end"))
    middle = (_TOP + height - _BOTTOM) / 2
    parts.append(_text((_LEFT + width - _RIGHT) / 2, height - 8, x.label, "middle"))
    parts.append(
        f'<text transform="translate(13 {middle}) rotate(-90)" text-anchor="middle" fill="{_INK}">'
        f"{escape(y.label)}</text>"
    )
    for one, points, colour in zip(series, kept, colours(series), strict=True):
        places = [(across(px), up(py)) for px, py in points]
        if one.line and len(places) > 1:
            path = "M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in places)
            dash = ' stroke-dasharray="5 4"' if one.dashed else ""
            parts.append(f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.6"{dash}/>')
        if one.marks:
            for (px, py), (vx, vy) in zip(places, points, strict=True):
                told = escape(f"{one.name}: {vx:.4g}, {vy:.4g}")
                parts.append(f"<g>{_mark(px, py, one.shape, colour)}<title>{told}</title></g>")
    return "\n".join([*parts, "</svg>"])


def figure(charts: Sequence[str], series: Sequence[Series], columns: int, size: tuple[int, int]) -> str:
    """Charts of one size in rows, with one legend below: a whole SVG file.

    Args:
        charts: of `chart()`, row by row.
        series: what the legend explains; those without a name are left out.
        columns: charts in a row.
        size: width and height of a chart, pixels.
    """
    width, height = columns * size[0], math.ceil(len(charts) / columns) * size[1]
    entries, x, y = [], _LEFT, height + 14
    for one, colour in zip(series, colours(series), strict=True):
        if not one.name:
            continue
        needed = 34 + _CHARACTER * len(one.name)
        if x + needed > width:
            x, y = _LEFT, y + _LEGEND_ROW
        if one.line:
            dash = ' stroke-dasharray="5 4"' if one.dashed else ""
            entries.append(
                f'<path d="M{x - 10:.0f} {y}h20" stroke="{colour}" stroke-width="1.6" fill="none"{dash}/>'
            )
        if one.marks:
            entries.append(_mark(x, y, one.shape, colour))
        entries.append(_text(f"{x + 14:.0f}", y + 4, one.name, "start"))
        x += round(needed)
    whole = y + _LEGEND_ROW if entries else height
    placed = [
        f'<g transform="translate({i % columns * size[0]} {i // columns * size[1]})">{one}</g>'
        for i, one in enumerate(charts)
    ]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{whole}" '
            f'viewBox="0 0 {width} {whole}" {_FONT}>',
            f'<rect width="{width}" height="{whole}" fill="white"/>',
            *placed,
            *entries,
            "</svg>",
        ]
    )


def colours(series: Sequence[Series]) -> list[str]:
    """The colour of each series: its own, or the next of COLOURS."""
    free = cycle(COLOURS)
    return [one.colour or next(free) for one in series]


class _Scale:
    """Values to pixels, with room at both ends."""

    def __init__(self, values: Sequence[float], axis: Axis, first: float, last: float) -> None:
        self.log, self.names, self.first, self.last = axis.log, axis.names, first, last
        places = [self._place(value) for value in values] or [0.0, 1.0]
        low, high = min(places), max(places)
        room = 0.05 * (high - low) or 0.05 * abs(high) or 0.5
        self.low, self.high = low - room, high + room

    def __call__(self, value: float) -> float:
        share = (self._place(value) - self.low) / (self.high - self.low)
        return self.first + share * (self.last - self.first)

    def ticks(self) -> list[tuple[float, str]]:
        """Round values inside the range, with their labels."""
        if self.names:
            return [(float(i), name) for i, name in enumerate(self.names) if self.low <= i <= self.high]
        if self.log and self.high - self.low > 0.7:  # else the range has too few powers of ten to mark
            digits = (1,) if self.high - self.low > 3 else (1, 2, 5)
            powers = range(math.floor(self.low), math.ceil(self.high) + 1)
            values = [digit * 10.0**power for power in powers for digit in digits]
        else:
            low, high = (10**end if self.log else end for end in (self.low, self.high))
            step = _round_step((high - low) / 6)
            values = [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
        inside = [v for v in values if (v > 0 or not self.log) and self.low <= self._place(v) <= self.high]
        return [(value, f"{value:.4g}") for value in inside]

    def _place(self, value: float) -> float:
        return math.log10(value) if self.log else value


def _round_step(least: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(digit * power for digit in (1, 2, 5, 10) if digit * power >= least * (1 - 1e-9))


def _fits(value: float, axis: Axis) -> bool:
    return math.isfinite(value) and (value > 0 or not axis.log)


def _text(x: float | str, y: float | str, text: str, anchor: str) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="{_INK}">{escape(text)}</text>'


def _mark(x: float, y: float, shape: int, colour: str) -> str:
    corners = {
        1: "M-3.2-3.2h6.4v6.4h-6.4z",
        2: "M0-4.2L4 3h-8z",
        3: "M0-4.4L4.4 0 0 4.4-4.4 0z",
    }
    look = f'fill="{colour}" stroke="white" stroke-width="0.7"'
    if shape not in corners:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" {look}/>'
    return f'<path transform="translate({x:.1f} {y:.1f})" d="{corners[shape]}" {look}/>'
