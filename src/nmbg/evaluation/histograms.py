"""Colour histograms of renders and photographs, and how far apart they are (paper, last figure)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from nmbg.atomic import atomic_file
from nmbg.images import Image, Mask

Counts = npt.NDArray[np.int64]
CHANNELS = ("red", "green", "blue")


def colour_histogram(image: Image, mask: Mask | None = None) -> Counts:
    """Pixels of each value, [3, 256]: red, green, blue.

    Args:
        image: [H, W, 3] uint8.
        mask: [H, W] bool, the pixels that count; None: all.
    """
    pixels = image.reshape(-1, 3) if mask is None else image[mask]
    return np.stack([np.bincount(channel, minlength=256) for channel in pixels.T])


def histogram_distance(a: Counts, b: Counts) -> npt.NDArray[np.float64]:
    """Earth mover's distance per channel, [3], in grey levels of 255.

    It is the mean step by which the sorted values of one would move to those of the other: a whole image that
    is n levels too bright has distance n.

    Args:
        a: counts [3, 256].
        b: likewise; of as many pixels or not.
    """
    share_a, share_b = (counts / counts.sum(axis=1, keepdims=True).clip(min=1) for counts in (a, b))
    distance: npt.NDArray[np.float64] = np.abs(np.cumsum(share_a - share_b, axis=1)).sum(axis=1)
    return distance


def write_histograms(path: Path, counts: Counts) -> None:
    """Write a table with a row per value, 0 to 255.

    Args:
        path: CSV file.
        counts: [2, 3, 256], of renders and photographs.
    """
    header = ",".join(["value", *(f"{kind}_{name}" for kind in ("render", "truth") for name in CHANNELS)])
    rows = np.concatenate([np.arange(256)[:, None], counts.reshape(6, 256).T], axis=1)
    with atomic_file(path) as file:
        np.savetxt(file, rows, fmt="%d", delimiter=",", header=header, comments="")


def read_histograms(path: Path) -> Counts:
    """Read what `write_histograms` wrote, [2, 3, 256]."""
    rows = np.loadtxt(path, dtype=np.int64, delimiter=",", skiprows=1)
    counts: Counts = rows[:, 1:].T.reshape(2, 3, 256)
    return counts
