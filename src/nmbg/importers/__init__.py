"""One module per capture format; `read_capture` finds the one that knows a folder.

An importer is a module with `NAME` (what it reads, for messages), `detect(source) -> bool` and
`read(source, images) -> Capture`. To add a format, write the module and name it in `IMPORTERS`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from nmbg.errors import NmbgError
from nmbg.importers import colmap
from nmbg.importers.capture import Capture, Photo

__all__ = ["IMPORTERS", "Capture", "Importer", "Photo", "read_capture"]


class Importer(Protocol):
    """What a format's module offers."""

    NAME: str

    def detect(self, source: Path) -> bool:
        """Whether the folder holds this format."""

    def read(self, source: Path, images: Path | None) -> Capture:
        """Read the folder; `images` overrides where the photographs lie."""


IMPORTERS: tuple[Importer, ...] = (colmap,)


def read_capture(source: Path, images: Path | None = None) -> Capture:
    """Read the cameras and find the photographs of a capture, whatever its format.

    Args:
        source: the capture's folder.
        images: where the photographs lie, when not at a usual place.

    Raises:
        NmbgError: no such folder, no known format in it, or photographs that cannot be used.
    """
    if not source.is_dir():
        raise NmbgError(f"{source}: no such folder; give the folder of a capture")
    for importer in IMPORTERS:
        if importer.detect(source):
            return importer.read(source, images)
    known = ", ".join(importer.NAME for importer in IMPORTERS)
    raise NmbgError(f"{source}: no cameras found (known: {known}); reconstruct the capture with COLMAP first")
