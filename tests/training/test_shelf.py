from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import pytest
import torch
from torch import Tensor

from nmbg.training import shelf
from nmbg.training.shelf import GIB, Shelf

ONE = 4 * 100  # bytes of a thing


def thing(seed: int) -> dict[str, Tensor]:
    return {"values": torch.rand(10, 10, generator=torch.Generator().manual_seed(seed))}


def test_what_memory_does_not_take_comes_back_from_disk_the_same(tmp_path: Path) -> None:
    kept: Shelf[dict[str, Tensor]] = Shelf(2 * ONE / GIB, tmp_path)
    for i in range(5):
        assert kept.get(i) is None
        kept.put(i, thing(i), ONE)
    assert kept.nbytes == 2 * ONE
    for i in (4, 0, 3, 3, 1, 2):
        found = kept.get(i)
        assert found is not None
        assert torch.equal(found["values"], thing(i)["values"])
    assert not list(tmp_path.iterdir())


def test_no_memory_keeps_nothing_on_disk_neither(tmp_path: Path) -> None:
    none: Shelf[dict[str, Tensor]] = Shelf(0.0, tmp_path)
    none.put(0, thing(0), ONE)
    assert none.get(0) is None


def test_without_a_folder_memory_is_the_limit() -> None:
    kept: Shelf[dict[str, Tensor]] = Shelf(1.5 * ONE / GIB)
    for i in range(2):
        kept.put(i, thing(i), ONE)
    assert kept.get(0) is not None
    assert kept.get(1) is None


def test_the_last_of_a_disk_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = shelf.SPARE + 4 * ONE + 1
    monkeypatch.setattr(shelf.shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    kept: Shelf[dict[str, Tensor]] = Shelf(1 / GIB, tmp_path)
    for i in range(6):
        kept.put(i, thing(i), ONE)
        free -= ONE if kept.get(i) is not None else 0
    assert [kept.get(i) is not None for i in range(6)] == [True] * 4 + [False] * 2


def test_all_shelves_together_keep_few_files_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shelf, "FILES", len(shelf._open_files) + 3)
    shelves: list[Shelf[dict[str, Tensor]]] = [Shelf(1 / GIB, tmp_path) for _ in range(2)]
    for i in range(3):
        for kept in shelves:
            kept.put(i, thing(i), ONE)
    assert sum(kept.get(i) is not None for kept in shelves for i in range(3)) == 3


def test_a_full_disk_ends_the_keeping_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    kept: Shelf[dict[str, Tensor]] = Shelf(1 / GIB, tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(shelf.torch, "save", full)
        kept.put(0, thing(0), ONE)
    assert kept.get(0) is None
    kept.put(1, thing(1), ONE)
    assert kept.get(1) is None
    assert not list(tmp_path.iterdir())
