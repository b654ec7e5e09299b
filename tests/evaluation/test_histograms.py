"""Colour histograms and their distance."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import wasserstein_distance

from nmbg.evaluation.histograms import (
    colour_histogram,
    histogram_distance,
    read_histograms,
    write_histograms,
)

rows = st.lists(st.integers(0, 255), min_size=1, max_size=40)


def image(values: list[int]) -> np.ndarray:
    return np.repeat(np.array(values, np.uint8)[None, :, None], 3, axis=2)


def test_pixels_outside_the_mask_do_not_count():
    picture = image([3, 3, 200])
    mask = np.array([[True, True, False]])
    counts = colour_histogram(picture, mask)
    assert counts.shape == (3, 256)
    assert counts[:, 3].tolist() == [2, 2, 2]
    assert counts.sum() == 6


@given(rows, rows)
def test_distance_is_the_earth_movers(a, b):
    distance = histogram_distance(*(colour_histogram(image(values)) for values in (a, b)))
    assert distance == pytest.approx(np.full(3, wasserstein_distance(a, b)), abs=1e-9)


@pytest.mark.parametrize("step", [0, 1, 40])
def test_distance_of_a_brighter_image_is_the_step(step):
    values = list(range(0, 200, 7))
    brighter = [value + step for value in values]
    assert histogram_distance(*map(colour_histogram, (image(values), image(brighter)))) == pytest.approx(step)


def test_what_is_written_is_read(tmp_path: Path):
    counts = np.random.default_rng(0).integers(0, 10**9, (2, 3, 256))
    write_histograms(tmp_path / "colours.csv", counts)
    assert np.array_equal(read_histograms(tmp_path / "colours.csv"), counts)
