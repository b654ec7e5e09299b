"""What every importer returns: the photographs of a capture with their cameras, not yet resampled."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmbg.cameras import Camera
from nmbg.colmap import pycolmap


@dataclass(frozen=True)
class Photo:
    """One registered photograph.

    Args:
        name: its name in the source; captures are sorted by it.
        path: the file.
        camera: the pinhole camera, of the undistorted photograph at the file's resolution.
        lens: the lens that the file was taken through, of the file's size; None for a pinhole.
    """

    name: str
    path: Path
    camera: Camera
    lens: pycolmap.Camera | None


@dataclass(frozen=True)
class Capture:
    """A capture as found on disk.

    Args:
        description: format and place, for the summary.
        photos: registered photographs, sorted by name.
        images: the folder that holds them.
        unregistered: names of the other photographs in that folder.
        absent: names of registered photographs that the folder lacks.
        mesh: the mesh found beside the cameras, or None.
    """

    description: str
    photos: tuple[Photo, ...]
    images: Path
    unregistered: tuple[str, ...]
    absent: tuple[str, ...]
    mesh: Path | None
