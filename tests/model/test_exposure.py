import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nmbg.model.exposure import (
    UNCHANGED,
    Exposure,
    Exposures,
    fit_exposure,
    mean_exposure,
    neighbours,
)

GAIN = torch.tensor([0.93, 1.0, 1.06])[:, None, None]
OFFSET = torch.tensor([0.02, -0.01, 0.0])[:, None, None]


def image(seed: int = 0) -> torch.Tensor:
    return torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(seed))


def test_an_exposure_is_found_among_pixels_that_show_something_else() -> None:
    colour = image()
    photograph = GAIN * colour + OFFSET
    photograph[:, :8] = 1 - photograph[:, :8]
    fitted = fit_exposure(photograph, colour, torch.ones(40, 50, dtype=torch.bool))
    # The ridge pulls gains towards 1 by about a hundredth of the way; alike by chance are few.
    torch.testing.assert_close(fitted.gain, GAIN, atol=0.01, rtol=0)
    torch.testing.assert_close(fitted.apply(colour)[:, 8:], photograph[:, 8:], atol=0.01, rtol=0)
    torch.testing.assert_close(fitted.undo(fitted.apply(colour)), colour)


@pytest.mark.parametrize("gain", [0.55, 0.75, 1.5])
def test_a_drift_that_no_bright_pixel_survives_at_first(gain: float) -> None:
    """Of a dark photograph only dark pixels look alike; the fit to these makes others look so."""
    colour = 0.6 * image()
    fitted = fit_exposure(gain * colour, colour, torch.ones(40, 50, dtype=torch.bool))
    torch.testing.assert_close(fitted.apply(colour), gain * colour, atol=0.03, rtol=0)


def test_pixels_that_do_not_count_do_not() -> None:
    colour, counted = image(), torch.ones(40, 50, dtype=torch.bool)
    photograph = GAIN * colour + OFFSET
    counted[:, 30:] = False
    other = photograph.clone()
    other[:, :, 30:] = colour[:, :, 30:]
    for one, two in zip(
        fit_exposure(photograph, colour, counted), fit_exposure(other, colour, counted), strict=True
    ):
        assert torch.equal(one, two)


@pytest.mark.parametrize("counted", [True, False])
def test_without_evidence_a_photograph_is_taken_as_it_is(counted: bool) -> None:
    """Nothing counts, or nothing is alike."""
    mask = torch.full((40, 50), counted)
    fitted = fit_exposure(torch.ones(3, 40, 50), torch.zeros(3, 40, 50), mask)
    assert torch.equal(fitted.apply(image()), image())


def test_one_colour_alone_changes_no_gain() -> None:
    flat = torch.full((3, 40, 50), 0.5)
    fitted = fit_exposure(flat + 0.03, flat, torch.ones(40, 50, dtype=torch.bool))
    torch.testing.assert_close(fitted.gain, torch.ones(3, 1, 1))
    torch.testing.assert_close(fitted.offset, torch.full((3, 1, 1), 0.03))


CENTRES = np.random.default_rng(3).uniform(-1, 1, (12, 3))


@given(t=st.floats(0, 1))
def test_weights_sum_to_one_and_move_with_the_view(t: float) -> None:
    def dense(place: float) -> np.ndarray:
        weights = np.zeros(len(CENTRES))
        indices, shares = neighbours((1 - place) * CENTRES[0] + place * CENTRES[1], CENTRES)
        weights[indices] = shares
        return weights

    here = dense(t)
    assert here.sum() == pytest.approx(1)
    assert (here > 0).sum() <= 4
    assert np.abs(dense(t + 1e-5) - here).max() < 0.02


def test_a_view_from_a_photographs_place_is_exposed_as_it_is() -> None:
    indices, weights = neighbours(CENTRES[5], CENTRES)
    assert weights[indices.index(5)] > 0.99


@pytest.mark.parametrize("n", [0, 1, 4, 5, 9])
def test_equally_near_photographs_count_alike(n: int) -> None:
    angles = np.arange(n) * 2 * np.pi / max(n, 1)
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1).reshape(-1, 3)
    _, weights = neighbours(np.zeros(3), ring)
    assert len(weights) == min(n, 4)
    assert weights == pytest.approx([1 / len(weights)] * len(weights) if n else [])


def test_the_mean_of_no_exposure_changes_nothing() -> None:
    assert torch.equal(mean_exposure([], []).apply(image()), image())
    both = mean_exposure([Exposure(GAIN, OFFSET), Exposure(2 * GAIN, OFFSET)], [0.5, 0.5])
    torch.testing.assert_close(both.gain, 1.5 * GAIN)


def _twice(n: int) -> Exposures:
    values = tuple(Exposure(torch.full((3, 1, 1), 1.0 + i), torch.full((3, 1, 1), 0.1 * i)) for i in range(n))
    centres = np.stack([np.arange(n), np.zeros(n), np.zeros(n)], 1).astype(np.float64)
    return Exposures(tuple(f"{i}.png" for i in range(n)), centres, values)


def test_a_photograph_has_its_own_exposure_and_another_place_that_of_those_around_it() -> None:
    found = _twice(9)
    assert found.of("3.png", np.zeros(3)) is found.values[3]
    elsewhere = found.of("new.png", np.array([4.0, 0.1, 0]))
    assert elsewhere.gain.mean() == pytest.approx(5, abs=0.2)
    assert found.around(np.array([4.0, 0.1, 0])).gain.equal(elsewhere.gain)


def test_what_is_left_out_does_not_count() -> None:
    found = _twice(3)
    kept = found.around(np.zeros(3), {"0.png", "2.png"})
    torch.testing.assert_close(kept.gain, found.values[1].gain)
    assert found.around(np.zeros(3), {"0.png", "1.png", "2.png"}) == UNCHANGED
