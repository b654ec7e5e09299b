"""What a sweep keeps its runs under."""

import importlib
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def sweep(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("sweep")


def test_networks_take_the_faster_precision_and_what_has_none_stays_as_it_is(
    sweep: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    for faster in (True, False):
        monkeypatch.setattr(sweep, "bf16_is_faster", lambda device, faster=faster: faster)
        assert sweep.in_precision(sweep.trained_for("nmbg", 1.0)).bf16 is faster
        assert not sweep.in_precision(sweep.trained_for("mesh", 1.0)).bf16
    assert sweep.in_precision(sweep.trained_for("nmbg", 1.0), bf16=True).bf16


def test_runs_are_kept_apart_by_what_was_asked_for(sweep: ModuleType, scene_folder: Path) -> None:
    """Seed, budget and a precision that is asked for; not the one that some processor is faster in."""
    configs = [sweep.trained_for("nmbg", minutes, seed) for minutes, seed in ((1.0, 0), (2.0, 0), (1.0, 1))]
    jobs = [sweep.Job(scene_folder, config) for config in configs]
    jobs += [sweep.Job(scene_folder, configs[0], bf16=bf16) for bf16 in (True, False)]
    assert len({job.key for job in jobs}) == len(jobs)
