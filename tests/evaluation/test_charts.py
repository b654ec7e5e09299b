"""Charts are well-formed SVG that shows every point in its place."""

import math
from xml.etree import ElementTree as ET

import pytest

from nmbg.evaluation.charts import COLOURS, Axis, Series, chart, figure

SVG = "{http://www.w3.org/2000/svg}"
SIZE = (420, 280)


def circles(svg: str) -> list[tuple[float, float]]:
    return [(float(c.get("cx")), float(c.get("cy"))) for c in ET.fromstring(svg).iter(f"{SVG}circle")]


def test_right_is_more_and_up_is_more():
    (x1, y1), (x2, y2) = circles(chart([Series("a", [(1, 10), (2, 30)])], Axis("x"), Axis("y")))
    assert 0 < x1 < x2 < SIZE[0]
    assert SIZE[1] > y1 > y2 > 0


def test_equal_factors_are_equal_steps_on_a_logarithmic_axis():
    x1, x2, x3 = (
        x for x, _ in circles(chart([Series("a", [(1, 0), (10, 0), (100, 0)])], Axis("x", True), Axis("y")))
    )
    assert x2 - x1 == pytest.approx(x3 - x2, abs=0.11)


@pytest.mark.parametrize("point", [(math.nan, 1), (1, math.inf), (0, 1), (-1, 1)])
def test_what_has_no_place_is_left_out(point):
    assert len(circles(chart([Series("a", [point, (2, 3)])], Axis("x", True), Axis("y")))) == 1


@pytest.mark.parametrize(
    "points", [[], [(1, 1)], [(0, 0), (0, 0)], [(1e-9, 1e9), (2e-9, -1e9)], [(5, 1e300)]]
)
@pytest.mark.parametrize("log", [False, True])
def test_any_points_give_a_chart(points, log):
    text = chart([Series("a", points)], Axis("x", log), Axis("y"))
    ET.fromstring(text)
    assert "nan" not in text


def test_ticks_are_round_and_inside():
    texts = [
        t.text
        for t in ET.fromstring(chart([Series("a", [(0, 0), (10, 1)])], Axis("x"), Axis("y"))).iter(
            f"{SVG}text"
        )
    ]
    assert {"0", "2", "4", "6", "8", "10"} <= set(texts)


def test_names_are_escaped_and_the_legend_names_each_series_once():
    series = [Series("a < b & c", [(1, 1)]), Series("", [(1, 2)]), Series("d", [(2, 2)], line=False, shape=1)]
    charts = [chart(series, Axis("x"), Axis("y"), title="<one>")] * 3
    root = ET.fromstring(figure(charts, series, 2, SIZE))
    texts = [t.text for t in root.iter(f"{SVG}text")]
    assert texts.count("a < b & c") == texts.count("d") == 1
    assert texts.count("<one>") == 3
    assert float(root.get("width")) == 2 * SIZE[0]
    assert 2 * SIZE[1] < float(root.get("height")) < 2 * SIZE[1] + 60


def test_a_series_has_its_own_colour_or_the_next():
    text = chart(
        [Series("a", [(1, 1)]), Series("b", [(1, 1)], colour="black"), Series("c", [(1, 1)])],
        Axis("x"),
        Axis("y"),
    )
    fills = [c.get("fill") for c in ET.fromstring(text).iter(f"{SVG}circle")]
    assert fills == [COLOURS[0], "black", COLOURS[1]]


def test_places_may_have_names() -> None:
    drawn = chart(
        [Series("a", [(0, 1.0), (2, 3.0)])], Axis("severity", names=("none", "some", "all")), Axis("dB")
    )
    texts = [text.text for text in ET.fromstring(drawn).iter(f"{SVG}text")]
    assert [text for text in texts if text in ("none", "some", "all")] == ["none", "some", "all"]
