"""The Pareto front, against its definition."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from nmbg.evaluation.pareto import pareto_front

few = st.integers(0, 6).map(float)  # so that equal values occur
points_lists = st.lists(st.tuples(few, few), max_size=30)


def beats(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[0] <= b[0] and a[1] >= b[1] and a != b


@given(points_lists)
def test_the_front_is_what_no_point_beats(points):
    front = pareto_front(points)
    kept = [points[i] for i in front]
    assert kept == sorted(set(kept))
    assert set(kept) == {p for p in points if not any(beats(q, p) for q in points)}


@given(points_lists)
def test_a_better_choice_costs_more(points):
    kept = [points[i] for i in pareto_front(points)]
    assert all(a[0] < b[0] and a[1] < b[1] for a, b in pairwise(kept))
