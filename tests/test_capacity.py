from pathlib import Path

from nmbg.capacity import choose_photographs
from nmbg.scene import Scene


def test_all_and_numbers(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    assert choose_photographs(scene, "all", 3) == scene.train
    assert choose_photographs(scene, len(scene.train), 3) == scene.train
    three = choose_photographs(scene, 3, 3)
    assert len(three) == 3
    assert set(three) < set(scene.train)


def test_the_first_choice_is_seen_by_most_others(scene_folder: Path) -> None:
    """Seven cameras stand on a ring with a gap: the one to keep is none of those beside the gap."""
    scene = Scene.load(scene_folder)
    (kept,) = choose_photographs(scene, 1, 1)
    assert 0 < scene.train.index(kept) < len(scene.train) - 1


def test_auto_keeps_photographs_that_stand_alone(scene_folder: Path) -> None:
    """Forty degrees apart, each of them adds something."""
    scene = Scene.load(scene_folder)
    assert len(choose_photographs(scene, "auto", 3)) >= 5
