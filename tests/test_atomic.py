"""Files and folders appear complete or not at all."""

from __future__ import annotations

import errno
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import SimpleNamespace

import pytest

from nmbg.atomic import MARK, atomic_file, atomic_folder
from nmbg.errors import NmbgError

HALF_WRITTEN = """
import sys, time
from pathlib import Path
from nmbg.atomic import atomic_folder
with atomic_folder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("half")
    print("ready", flush=True)
    time.sleep(60)
"""


def fail_half_way(
    block: AbstractContextManager[Path], write: Callable[[Path], object], error: type[BaseException]
) -> None:
    with block as temporary:
        write(temporary)
        raise error


def test_a_file_appears_with_its_whole_content(tmp_path: Path) -> None:
    path = tmp_path / "new" / "notes.txt"
    with atomic_file(path) as temporary:
        assert temporary.suffix == ".txt"
        temporary.write_text("whole")
        assert not path.exists()
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


def test_a_failed_write_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError):
        fail_half_way(atomic_file(path), lambda temporary: temporary.write_text("ne"), ZeroDivisionError)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "scene"
    with atomic_folder(path) as temporary:
        (temporary / "a").write_text("a")
        assert not path.exists()
    assert (path / "a").read_text() == "a"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt, SystemExit])
def test_a_failed_folder_leaves_nothing_new(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "scene"
    with atomic_folder(path) as temporary:
        (temporary / "old").write_text("old")
    again = atomic_folder(path, overwrite=True)
    with pytest.raises(error):
        fail_half_way(again, lambda temporary: (temporary / "new").write_text("new"), error)
    assert (path / "old").exists()
    assert not (path / "new").exists()
    assert list(tmp_path.iterdir()) == [path]


def test_overwriting_replaces_the_whole_folder(tmp_path: Path) -> None:
    path = tmp_path / "scene"
    for name in ("first", "second"):
        with atomic_folder(path, overwrite=True) as temporary:
            (temporary / name).write_text(name)
    assert sorted(file.name for file in path.iterdir()) == [MARK, "second"]
    assert list(tmp_path.iterdir()) == [path]


def test_an_existing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match=r"exists already.*--overwrite"), atomic_folder(tmp_path):
        pytest.fail("entered")


def test_a_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    precious = tmp_path / "home" / "thesis.tex"
    precious.parent.mkdir()
    precious.write_text("years of work")
    with (
        pytest.raises(NmbgError, match="was not written by nmbg"),
        atomic_folder(precious.parent, overwrite=True),
    ):
        pytest.fail("entered")
    assert precious.read_text() == "years of work"


@pytest.mark.skipif(sys.platform == "win32", reason="needs file locks")
def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path: Path) -> None:
    path = tmp_path / "scene"
    with subprocess.Popen(
        [sys.executable, "-c", HALF_WRITTEN, str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        with atomic_folder(path) as temporary:  # the other still runs: its work is left alone
            assert len(list(tmp_path.iterdir())) == 2
            (temporary / "whole").write_text("whole")
        process.send_signal(signal.SIGKILL)
    assert sorted(file.name for file in path.iterdir()) == [MARK, "whole"]
    assert len(list(tmp_path.iterdir())) == 2
    with atomic_folder(path, overwrite=True):
        pass
    assert list(tmp_path.iterdir()) == [path]


def test_folders_of_similar_names_are_left_alone(tmp_path: Path) -> None:
    neighbours = [tmp_path / ".scene.notes", tmp_path / ".scene.x.partial"]
    for neighbour in neighbours:
        neighbour.mkdir()
    with atomic_folder(tmp_path / "scene"):
        pass
    assert all(neighbour.is_dir() for neighbour in neighbours)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    with pytest.raises(OSError, match=r"No space left.*notes\.txt") as caught, atomic_file(path):
        Path("/dev/full").write_text("x")
    assert caught.value.errno == errno.ENOSPC


def test_a_full_disk_is_recognised_behind_any_error_of_a_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.bin"
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    with pytest.raises(OSError, match=r"model\.bin") as caught, atomic_file(path):
        raise RuntimeError("unexpected pos 64 vs 0")
    assert caught.value.errno == errno.ENOSPC
