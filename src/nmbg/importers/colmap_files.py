"""Whether COLMAP's binary files are complete: pycolmap reads on behind the end of a file that was cut off.

It then takes what lies in memory for counts, allocates without bound, or returns wrong parameters. Layouts:
COLMAP's documentation, "Output format".
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from nmbg.colmap import pycolmap
from nmbg.errors import NmbgError

POSE = 7 * 8  # rotation and translation, bytes


class _Cursor:
    """A place in a file's bytes; stepping behind the end is an EOFError."""

    def __init__(self, data: bytes) -> None:
        self.data, self.place = data, 0

    def number(self, layout: str) -> int:
        """The little-endian number at this place ("B": 8 bits, "I": 32, "Q": 64); steps behind it."""
        start = self.place
        self.skip(struct.calcsize(f"<{layout}"))
        value: int = struct.unpack_from(f"<{layout}", self.data, start)[0]
        return value

    def skip(self, n: int) -> None:
        """Step over n bytes."""
        self.place += n
        if self.place > len(self.data):
            raise EOFError

    def skip_text(self) -> None:
        """Step behind the next zero byte."""
        end = self.data.find(b"\0", self.place)
        if end < 0:
            raise EOFError
        self.place = end + 1


def _camera(cursor: _Cursor) -> None:
    cursor.number("I")
    model = pycolmap.CameraModelId(cursor.number("I"))
    cursor.skip(8 + 8)  # width, height
    cursor.skip(8 * len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 1, 1).params))


def _image(cursor: _Cursor) -> None:
    cursor.skip(4 + POSE + 4)
    cursor.skip_text()
    cursor.skip(24 * cursor.number("Q"))  # u, v, point


def _point(cursor: _Cursor) -> None:
    cursor.skip(8 + 3 * 8 + 3 + 8)  # number, position, colour, error
    cursor.skip(8 * cursor.number("Q"))


def _rig(cursor: _Cursor) -> None:
    cursor.number("I")
    sensors = cursor.number("I")
    for i in range(sensors):
        cursor.skip(8)
        if i > 0 and cursor.number("B"):  # all but the first may have a pose
            cursor.skip(POSE)


def _frame(cursor: _Cursor) -> None:
    cursor.skip(4 + 4 + POSE)
    cursor.skip(16 * cursor.number("I"))


RECORDS: dict[str, Callable[[_Cursor], None]] = {
    "cameras.bin": _camera,
    "images.bin": _image,
    "points3D.bin": _point,
    "rigs.bin": _rig,
    "frames.bin": _frame,
}


def check_complete(model: Path) -> None:
    """Walk through the binary files of a model, as far as there are any.

    Raises:
        NmbgError: a file ends within a record.
    """
    for name, skip_record in RECORDS.items():
        path = model / name
        if not path.is_file():
            continue
        cursor = _Cursor(path.read_bytes())
        try:
            for _ in range(cursor.number("Q")):
                skip_record(cursor)
        except (EOFError, ValueError) as error:
            raise NmbgError(f"{path}: damaged or truncated COLMAP model; copy or export it again") from error
