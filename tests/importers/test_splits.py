from __future__ import annotations

import json
from pathlib import Path

import pytest

from nmbg.errors import NmbgError
from nmbg.importers.splits import every_nth, read_split

NAMES = [f"{i:02d}.jpg" for i in range(10)]


def test_every_eighth_counts_sorted_names_from_the_first() -> None:
    assert every_nth(NAMES[::-1], 8) == ["00.jpg", "08.jpg"]
    assert every_nth(NAMES, 1) == NAMES
    assert every_nth(NAMES, 0) == []


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("split.json", json.dumps({"test": ["03.jpg", "07.jpg"]})),
        ("split.json", json.dumps({"test": [3, 7]})),
        (
            "split.json",
            json.dumps({"test": [7, "3"], "train": [n for n in NAMES if n not in ("03.jpg", "07.jpg")]}),
        ),
        ("split.txt", "03.jpg\n\n 07.jpg\n"),
        ("split.txt", "3\n7\n"),
    ],
)
def test_names_and_indices_in_json_and_text_mean_the_same(file: str, content: str, tmp_path: Path) -> None:
    (tmp_path / file).write_text(content)
    train, test = read_split(tmp_path / file, NAMES)
    assert test == ["03.jpg", "07.jpg"]
    assert train == [name for name in NAMES if name not in test]


def test_a_name_that_is_a_number_is_a_name_first(tmp_path: Path) -> None:
    (tmp_path / "split.txt").write_text("1\n")
    assert read_split(tmp_path / "split.txt", ["0", "2", "1"])[1] == ["1"]


def test_images_in_neither_part_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "split.json").write_text(json.dumps({"test": [0], "train": [1, 2]}))
    assert read_split(tmp_path / "split.json", NAMES) == (["01.jpg", "02.jpg"], ["00.jpg"])


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("split.txt", "nothing.jpg", "no registered image 'nothing.jpg'"),
        ("split.txt", "10", "no registered image '10'"),
        ("split.json", '{"test": [-1]}', "no registered image -1"),
        ("split.json", '{"test": [0], "train": [0, 1]}', "00.jpg is in both parts"),
        ("split.json", '{"train": [0]}', "not a split"),
        ("split.json", '{"test": "00.jpg"}', "not a split"),
        ("split.json", "[0, 1]", "not a split"),
        ("split.json", "{", "not a split"),
    ],
)
def test_wrong_splits_are_named(file: str, content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / file).write_text(content)
    with pytest.raises(NmbgError, match=message) as caught:
        read_split(tmp_path / file, NAMES)
    assert str(tmp_path / file) in str(caught.value)


def test_an_absent_split_is_named(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="no such split file"):
        read_split(tmp_path / "split.json", NAMES)
