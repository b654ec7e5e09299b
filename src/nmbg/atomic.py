"""Files and folders that appear complete or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

from nmbg.errors import NmbgError

if sys.platform != "win32":
    import fcntl

MARK = ".nmbg"  # stands in every folder written here: only such folders are ever replaced
_PARTIAL = ".partial"
_FULL = 64 * 1024  # a disk with less free space than this is full, bytes


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block ends without an error.

    Raises:
        OSError: what the file system says, with a file name; for a full disk, whatever the writer raised.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # The suffix stays: writers of images and meshes choose their format by it.
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        with _full_disk_named(path):
            yield temporary
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder beside `path`; rename it to `path` when the block ends without an error.

    What a killed process left beside `path` is removed by the next call.

    Raises:
        NmbgError: `path` exists and `overwrite` is false, or it is nothing that was written here.
        OSError: as in `atomic_file`.
    """
    refuse_existing(path, overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_abandoned(path)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=_PARTIAL, dir=path.parent))
    lock = os.open(temporary / MARK, os.O_CREAT | os.O_WRONLY)
    try:
        _lock(lock)
        temporary.chmod(0o755)
        with _full_disk_named(path):
            yield temporary
            _move(temporary, path)
    finally:
        os.close(lock)
        shutil.rmtree(temporary, ignore_errors=True)


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Check that a folder may be written.

    Raises:
        NmbgError: `path` exists and may not be replaced: `overwrite` is false, or nmbg did not write it.
    """
    if not path.exists():
        return
    if not overwrite:
        raise NmbgError(f"{path}: exists already; choose another folder or pass --overwrite")
    if not path.is_dir() or (any(path.iterdir()) and not (path / MARK).exists()):
        raise NmbgError(f"{path}: was not written by nmbg, so it is not replaced; choose another folder")


def _move(temporary: Path, path: Path) -> None:
    """Rename to `path`; what stood there is first set aside, so that one of the two is always complete."""
    if not path.exists():
        temporary.rename(path)
        return
    aside = temporary.with_name(f"{temporary.stem}.old{_PARTIAL}")
    path.rename(aside)
    temporary.rename(path)
    shutil.rmtree(aside)


def _remove_abandoned(path: Path) -> None:
    """Remove temporary folders of `path` whose writer no longer runs."""
    for folder in path.parent.glob(f".{escape(path.name)}.*{_PARTIAL}"):
        with suppress(OSError):
            mark = os.open(folder / MARK, os.O_WRONLY)
            try:
                if _lock(mark):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(mark)


def _lock(descriptor: int) -> bool:
    """Lock an open file until it is closed or its process ends; False when another process holds the lock."""
    if sys.platform == "win32":
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


@contextmanager
def _full_disk_named(path: Path) -> Iterator[None]:
    """Every writer tells of a full disk in its own words, or in none: say it once, with the file's name."""
    try:
        yield
    except NmbgError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            raise
        if shutil.disk_usage(path.parent).free < _FULL:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        raise
