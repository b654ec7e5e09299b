from dataclasses import replace

import pytest

from nmbg.training.budget import Budget, Clock
from nmbg.training.config import PRESETS, Stage, TrainConfig

CONFIG = replace(PRESETS["mesh"], stages=(Stage(1, False), Stage(3, True)))


def test_steps_count_iterations_or_epochs() -> None:
    assert Budget(replace(CONFIG, iterations=10), 7, Clock()).progress(5) == 0.5
    assert Budget(replace(CONFIG, epochs=2), 7, Clock()).progress(7) == 0.5
    assert Budget(replace(CONFIG, iterations=10), 7, Clock()).progress(99) == 1


def test_minutes_count_the_time_of_all_sessions() -> None:
    config = replace(CONFIG, minutes=2)
    assert Budget(config, 7, Clock(before=60)).progress(0) == pytest.approx(0.5, abs=0.01)
    assert Budget(config, 7, Clock(before=121)).progress(0) == 1


def test_minutes_end_early_when_the_views_were_seen_often_enough() -> None:
    config = replace(CONFIG, minutes=60, passes=3)
    assert Budget(config, 7, Clock()).progress(7) == pytest.approx(1 / 3)
    assert Budget(config, 7, Clock()).progress(21) == 1
    assert Budget(config, 7, Clock(before=1800)).progress(7) == pytest.approx(0.5, abs=0.01)
    # Who asks for steps gets them.
    asked = replace(config, minutes=None, iterations=100)
    assert Budget(asked, 7, Clock()).progress(50) == 0.5


@pytest.mark.parametrize("config", [replace(CONFIG, iterations=0), replace(CONFIG, stages=())])
def test_nothing_to_do_is_over_at_once(config: TrainConfig) -> None:
    assert Budget(config, 7, Clock()).progress(0) == 1


@pytest.mark.parametrize(
    ("progress", "expected"), [(0, (0, 0)), (0.125, (0, 0.5)), (0.25, (1, 0)), (0.625, (1, 0.5))]
)
def test_stages_share_the_budget(progress: float, expected: tuple[int, float]) -> None:
    assert Budget(replace(CONFIG, iterations=8), 7, Clock()).stage(progress) == expected


def test_one_budget_only() -> None:
    with pytest.raises(ValueError, match="one of"):
        replace(CONFIG, minutes=1, epochs=1)


@pytest.mark.parametrize("name", ["l1", "perceptual", "adversarial", "descriptor_rate", "network_rate"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_weights_and_rates_that_cannot_be_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^{name}: expected a finite number"):
        replace(CONFIG, stages=(replace(CONFIG.stages[0], **{name: value}),))
