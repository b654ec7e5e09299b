"""Sheets: render, truth and error side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio

from nmbg.images import Image, resize

ERROR_RANGE = 0.25  # the error that the scale's upper end shows; fixed, so that sheets can be compared
HEADINGS = ("render", "truth", "absolute error, images in 0 to 1")

_GAP, _TEXT, _BAND = 8, 15, 24  # space between panels, height of letters and of a line of text, pixels
_BACKGROUND, _INK = 24, (0.9, 0.9, 0.9)
_SCALE = np.array([[0, 0, 0], [66, 10, 104], [188, 55, 84], [249, 142, 9], [252, 255, 190]])  # dark to bright


@dataclass(frozen=True)
class Row:
    """One view of a sheet: what is written above it, then its panels [H, W, 3] uint8 of one size."""

    label: str
    panels: tuple[Image, ...]


def error_map(estimate: Image, target: Image) -> Image:
    """Mean absolute error over the channels of two [H, W, 3] uint8 images, in colours [H, W, 3] uint8."""
    error = np.abs(estimate.astype(np.float32) - target.astype(np.float32)).mean(axis=2) / 255
    return colour_scale(error / ERROR_RANGE)


def colour_scale(values: npt.NDArray[np.floating]) -> Image:
    """Colours [..., 3] uint8 of values [...]: black at 0, bright yellow from 1 on."""
    stops = np.linspace(0, 1, len(_SCALE))
    return np.stack([np.interp(values, stops, channel).round() for channel in _SCALE.T], axis=-1).astype(
        np.uint8
    )


def view_row(label: str, estimate: Image, target: Image, width: int = 400) -> Row:
    """A row of render, truth and error map, reduced to at most `width` pixels each."""
    height, full_width, _ = estimate.shape
    width = min(width, full_width)
    height = max(1, round(height * width / full_width))
    images = (estimate, target, error_map(estimate, target))
    return Row(label, tuple(resize(image, width, height) for image in images))


def sheet(rows: Sequence[Row], headings: Sequence[str] = HEADINGS, errors: bool = True) -> Image:
    """All rows below one another, with headings.

    Args:
        rows: at least one; the panels of a row have one size, rows may differ.
        headings: of the columns.
        errors: the last column shows error maps; their scale comes below it.

    Returns:
        [H, W, 3] uint8.
    """
    column = _GAP + max(panel.shape[1] for row in rows for panel in row.panels)
    heights = [row.panels[0].shape[0] for row in rows]
    bands = len(rows) + (3 if errors else 1)
    size = (bands * _BAND + sum(heights) + len(rows) * _GAP, _GAP + len(headings) * column)
    canvas = np.full((*size, 3), _BACKGROUND, dtype=np.uint8)
    texts = [(_GAP + i * column, 0, heading) for i, heading in enumerate(headings)]
    y = _BAND
    for row, height in zip(rows, heights, strict=True):
        texts.append((_GAP, y, row.label))
        for i, panel in enumerate(row.panels):
            x = _GAP + i * column
            canvas[y + _BAND : y + _BAND + height, x : x + panel.shape[1]] = panel
        y += _BAND + height + _GAP
    if errors:
        x, width = _GAP + (len(headings) - 1) * column, column - _GAP
        canvas[y : y + _BAND, x : x + width] = colour_scale(np.linspace(0, 1, width))
        ticks = ((0.0, "0"), (0.45, f"{ERROR_RANGE / 2:g}"), (0.82, f"{ERROR_RANGE:g}+"))
        texts += [(x + round(share * width), y + _BAND, text) for share, text in ticks]
    return _write(canvas, texts)


def _write(canvas: Image, texts: Sequence[tuple[int, int, str]]) -> Image:
    """Write (x, y, text), the left and upper corner of its line; nothing where OpenImageIO has no fonts."""
    buffer = oiio.ImageBuf(canvas)
    for x, y, text in texts:
        oiio.ImageBufAlgo.render_text(buffer, x, y + _BAND - 7, text, _TEXT, "", _INK)
    written = buffer.get_pixels(oiio.UINT8)
    return canvas if written is None else written
