"""Error maps and sheets."""

import numpy as np
import pytest

from nmbg.evaluation.figures import ERROR_RANGE, colour_scale, error_map, sheet, view_row


def flat(value: int, height: int = 30, width: int = 40) -> np.ndarray:
    return np.full((height, width, 3), value, dtype=np.uint8)


def test_no_error_is_black():
    assert not error_map(flat(100), flat(100)).any()


def test_error_has_no_sign_and_does_not_wrap():
    np.testing.assert_array_equal(error_map(flat(10), flat(250)), error_map(flat(250), flat(10)))


def test_larger_errors_are_brighter_up_to_the_range():
    brightness = colour_scale(np.linspace(0, 1, 101)).astype(int).sum(axis=-1)
    assert (np.diff(brightness) >= 0).all()
    assert brightness[-1] > brightness[50] > brightness[0] == 0


def test_errors_beyond_the_range_stay_at_its_end():
    end = round(255 * ERROR_RANGE)
    np.testing.assert_array_equal(error_map(flat(0), flat(end + 1)), error_map(flat(0), flat(255)))
    assert (error_map(flat(0), flat(end // 2)) != error_map(flat(0), flat(255))).any()


@pytest.mark.parametrize(("width", "expected"), [(400, (30, 40)), (20, (15, 20))])
def test_panels_are_reduced_but_never_enlarged(width, expected):
    row = view_row("view", flat(1), flat(2), width)
    assert [panel.shape[:2] for panel in row.panels] == [expected] * 3


def test_sheet_holds_rows_of_other_sizes():
    rows = [
        view_row("wide", flat(200, 10, 60), flat(0, 10, 60)),
        view_row("tall", flat(90, 50, 20), flat(0, 50, 20)),
    ]
    picture = sheet(rows)
    assert picture.dtype == np.uint8
    assert picture.shape[1] == 3 * 68 + 8
    assert (picture == 200).all(axis=-1).sum() >= 10 * 60
    assert (picture == 90).all(axis=-1).sum() >= 50 * 20


def test_scale_stands_under_the_error_maps():
    picture = sheet([view_row("view", flat(0), flat(255))])
    bars = (picture == colour_scale(np.array(1.0))).all(axis=-1)
    assert bars[48:78, 104:144].all()  # the error map itself, wholly at the end of the scale
    assert bars[86:110].sum() >= 24  # the bright end of the scale bar


def test_pictures_without_error_maps_have_no_scale():
    rows = [view_row("view", flat(0), flat(0))]
    with_scale, without = sheet(rows), sheet(rows, errors=False)
    assert without.shape[0] < with_scale.shape[0]
    assert np.array_equal(with_scale[: without.shape[0]], without)
