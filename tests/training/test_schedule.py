import itertools
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmbg.training.schedule import BLOCK, Schedule, Turn, extra_steps, shard

counts = st.lists(st.integers(1, 40), min_size=1, max_size=5)


@given(counts, st.floats(0, 0.8), st.integers(0, 99))
def test_a_pass_visits_every_training_view_once(counts: list[int], share: float, seed: int) -> None:
    schedule = Schedule(counts, share, seed)
    for number in range(2):
        turns = [schedule.turn(number * schedule.length + i) for i in range(schedule.length)]
        seen = Counter(turn for turn in turns if turn.view is not None)
        assert seen == Counter(Turn(s, i) for s, count in enumerate(counts) for i in range(count))
        for scene, count in enumerate(counts):
            artificial = sum(turn == Turn(scene, None) for turn in turns)
            assert artificial == extra_steps(count, share)
            assert artificial / (count + artificial) == pytest.approx(share, abs=0.5 / count + 0.01)


def test_a_step_is_the_same_whenever_it_is_asked_for() -> None:
    a, b = Schedule([7, 12], 0.3, 5), Schedule([7, 12], 0.3, 5)
    expected = [a.turn(step) for step in range(60)]
    assert [b.turn(step) for step in reversed(range(60))] == expected[::-1]
    assert [Schedule([7, 12], 0.3, 6).turn(step) for step in range(60)] != expected


def test_several_scenes_take_turns_in_blocks() -> None:
    schedule = Schedule([64, 64], 0.0, 0)
    scenes = [schedule.turn(step).scene for step in range(schedule.length)]
    changes = sum(a != b for a, b in itertools.pairwise(scenes))
    assert 0 < changes < len(scenes) / BLOCK


def test_a_process_with_fewer_images_begins_again() -> None:
    schedule = Schedule([3], 0.0, 0, length=8)
    views = [schedule.turn(step).view for step in range(8)]
    assert Counter(views[:3]) == Counter(views[3:6]) == Counter([0, 1, 2])


@given(st.lists(st.integers(1, 300), min_size=1, max_size=12), st.data())
def test_scenes_are_dealt_out_evenly(counts: list[int], data: st.DataObject) -> None:
    parts = data.draw(st.integers(1, len(counts)))
    dealt = shard(counts, parts)
    assert sorted(i for part in dealt for i in part) == list(range(len(counts)))
    loads = [sum(counts[i] for i in part) for part in dealt]
    assert min(loads) > 0
    # The last scene that a process was dealt, its smallest, went to the one with the least.
    for part, load in zip(dealt, loads, strict=True):
        assert load - min(counts[i] for i in part) <= min(loads)
