"""What is costly to make anew: kept in memory up to a limit, beyond it in files that are mapped into it."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

import torch

GIB = 2**30
SPARE = 4 * GIB  # of the disk, left to others
FILES = 512  # at most, on all shelves, of the thousand that a process may commonly have open
_open_files: weakref.WeakSet[IO[bytes]] = weakref.WeakSet()

Thing = TypeVar("Thing")


class Shelf(Generic[Thing]):
    """Things with tensors in them, by key.

    Files have no name: they are gone with the process, however it ends. What is mapped is memory that the
    system takes back where it is short of it.

    Args:
        memory_gib: memory for things, GiB; with 0 nothing is kept, on disk neither.
        folder: on the disk that takes what is beyond that; None for memory alone.
    """

    def __init__(self, memory_gib: float, folder: Path | None = None) -> None:
        self._memory = int(memory_gib * GIB)
        self._folder = folder if memory_gib else None
        self._kept: dict[Any, Thing] = {}
        self._files: dict[Any, IO[bytes]] = {}
        self._open = ExitStack()
        weakref.finalize(self, self._open.close)
        self.nbytes = 0  # of memory held

    def get(self, key: Any) -> Thing | None:
        """What was put there; None where nothing is kept. Not to be changed."""
        file = self._files.get(key)
        if file is None:
            return self._kept.get(key)
        thing: Thing = torch.load(f"/dev/fd/{file.fileno()}", mmap=True, weights_only=False)
        return thing

    def put(self, key: Any, thing: Thing, nbytes: int) -> None:
        """Keep a thing of so many bytes, where there is room for it."""
        if self.nbytes + nbytes <= self._memory:
            self.nbytes += nbytes
            self._kept[key] = thing
        elif self._folder is not None and len(_open_files) < FILES:
            try:
                if shutil.disk_usage(self._folder).free - nbytes < SPARE:
                    return
                file = self._open.enter_context(tempfile.TemporaryFile(dir=self._folder))  # noqa: SIM115
                _open_files.add(file)
                torch.save(thing, file)
                file.flush()
            except OSError:  # a disk that has filled up is no reason to end
                self._folder = None
            else:
                self._files[key] = file
