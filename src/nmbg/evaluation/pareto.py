"""Which of several choices are worth a thought: those that no other beats in both respects."""

from __future__ import annotations

from collections.abc import Sequence


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other point beats, cheapest first.

    Args:
        points: (cost, worth): less cost and more worth are better.

    Returns:
        indices of points to which no other is at least equal in both and better in one; of equal points the
        first alone.
    """
    order = sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1], i))
    front: list[int] = []
    for i in order:
        if not front or points[i][1] > points[front[-1]][1]:
            front.append(i)
    return front
