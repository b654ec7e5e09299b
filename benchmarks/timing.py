"""How often, and side by side: medians and quartiles of calls."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def quartiles(seconds: list[float]) -> dict[str, float]:
    """Median and quartiles in milliseconds."""
    low, middle, high = statistics.quantiles(seconds, n=4)
    return {"ms": 1000 * middle, "low": 1000 * low, "high": 1000 * high}


def alternate(calls: dict[str, Callable[[], object]], repeats: int) -> dict[str, dict[str, float]]:
    """Time calls in turn, so that a slow moment of the machine hits all; after one turn to warm up."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeats + 1):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            if turn:
                seconds[name].append(time.perf_counter() - start)
    return {name: quartiles(of) for name, of in seconds.items()}


def timed(call: Callable[[], object], repeats: int) -> dict[str, float]:
    """Median and quartiles of one call in milliseconds, after one to warm up."""
    return alternate({"call": call}, repeats)["call"]


def show(times: dict[str, float]) -> str:
    """Median (quartiles), ms."""
    return f"{times['ms']:.1f} ({times['low']:.1f}–{times['high']:.1f})"
