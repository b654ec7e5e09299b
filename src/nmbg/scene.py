"""The scene folder: cameras, photographs and geometry of one capture (docs/formats.md)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

import nmbg
from nmbg.atomic import atomic_file
from nmbg.cameras import Camera
from nmbg.errors import NmbgError
from nmbg.images import Image, Mask, read_image, read_mask
from nmbg.mesh import Mesh, load_mesh, save_mesh
from nmbg.packed_mesh import load_packed

# Raise when a scene folder that an older program wrote would be read wrongly.
VERSION = 1
GEOMETRY, PACKED_GEOMETRY = "geometry.ply", "geometry.npz"  # one of the two

Split = Literal["train", "test"]


T = TypeVar("T")


def evenly(items: Sequence[T], n: int) -> list[T]:
    """So many of the items, spread evenly over their order; all when there are fewer."""
    n = min(n, len(items))
    return [items[int((i + 0.5) * len(items) / n)] for i in range(n)]


@dataclass(frozen=True)
class View:
    """One photograph of a scene.

    Args:
        name: the photograph's name in the source.
        camera: of the photograph as stored.
        split: whether it is trained on.
        image: file below images/.
        mask: file below masks/, or None.
    """

    name: str
    camera: Camera
    split: Split
    image: str
    mask: str | None


@dataclass(frozen=True, eq=False)
class Scene:
    """A capture ready to train on.

    Args:
        folder: where it lies.
        mesh: the geometry; the far shell comes last.
        shell_vertices: how many of the last vertices are the shell's.
        shell_faces: how many of the last faces are the shell's.
        views: sorted by name.
        centre: of the foreground sphere, [3] float64, scene units.
        radius: of the foreground sphere, scene units.
        up: unit up axis, [3] float64.
        layers: 1, or 2 when foreground and background are rendered apart.
        summary: what preprocessing found, ready for JSON.
        source: what the scene was made from, as the user named it.
    """

    folder: Path
    mesh: Mesh
    shell_vertices: int
    shell_faces: int
    views: tuple[View, ...]
    centre: npt.NDArray[np.float64]
    radius: float
    up: npt.NDArray[np.float64]
    layers: int
    summary: dict[str, Any] = field(default_factory=dict)
    source: str = ""

    @property
    def train(self) -> tuple[View, ...]:
        """The training views, in the scene's order."""
        return tuple(view for view in self.views if view.split == "train")

    @property
    def test(self) -> tuple[View, ...]:
        """The held-out views, in the scene's order."""
        return tuple(view for view in self.views if view.split == "test")

    def load_image(self, view: View) -> Image:
        """The photograph, [H, W, 3] uint8, read from disk.

        Raises:
            NmbgError: absent, damaged, or not of the camera's size.
        """
        path = self.folder / "images" / view.image
        image = read_image(path)
        _check_size(image, view.camera, path)
        return image

    def load_mask(self, view: View) -> Mask | None:
        """The mask, [H, W] bool, true where the photograph counts; None when the view has none."""
        if view.mask is None:
            return None
        path = self.folder / "masks" / view.mask
        mask = read_mask(path)
        _check_size(mask, view.camera, path)
        return mask

    def save(self, folder: Path) -> None:
        """Write scene.json and geometry.ply; images and masks are put beside them by who made them."""
        save_mesh(self.mesh, folder / GEOMETRY)
        record = {
            "version": VERSION,
            "tool": f"nmbg {nmbg.__version__}",
            "source": self.source,
            "sphere": {"centre": self.centre.tolist(), "radius": self.radius},
            "up": self.up.tolist(),
            "layers": self.layers,
            "shell": {"vertices": self.shell_vertices, "faces": self.shell_faces},
            "views": [_view_record(view) for view in self.views],
            "summary": self.summary,
        }
        with atomic_file(folder / "scene.json") as path:
            path.write_text(json.dumps(record, indent=1) + "\n")

    @staticmethod
    def load(folder: Path) -> Scene:
        """Read a scene folder.

        Raises:
            NmbgError: no scene, of another version, or incomplete.
        """
        path = folder / "scene.json"
        if not path.is_file():
            raise NmbgError(
                f"{folder}: not a scene folder (no scene.json); make one with: nmbg preprocess SOURCE SCENE"
            )
        try:
            record = json.loads(path.read_text())
            version = record["version"]
        except (ValueError, KeyError, TypeError) as error:
            raise NmbgError(f"{path}: damaged or not a scene; {_REMEDY}") from error
        if version != VERSION:
            raise NmbgError(f"{path}: version {version}, this program reads version {VERSION}; {_REMEDY}")
        packed = folder / PACKED_GEOMETRY
        mesh = load_packed(packed) if packed.exists() else load_mesh(folder / GEOMETRY)[0]
        try:
            scene = _scene_from_record(folder, mesh, record)
        except (ValueError, KeyError, TypeError) as error:
            raise NmbgError(f"{path}: incomplete or damaged ({error!r}); {_REMEDY}") from error
        if scene.shell_vertices > len(mesh.vertices) or scene.shell_faces > len(mesh.faces):
            raise NmbgError(f"{path}: does not belong to the geometry beside it; {_REMEDY}")
        return scene


_REMEDY = "make the scene again with: nmbg preprocess --overwrite"


def _scene_from_record(folder: Path, mesh: Mesh, record: dict[str, Any]) -> Scene:
    return Scene(
        folder=folder,
        mesh=mesh,
        shell_vertices=int(record["shell"]["vertices"]),
        shell_faces=int(record["shell"]["faces"]),
        views=tuple(_view_from_record(view) for view in record["views"]),
        centre=_array(record["sphere"]["centre"], (3,)),
        radius=float(record["sphere"]["radius"]),
        up=_array(record["up"], (3,)),
        layers=int(record["layers"]),
        summary=dict(record["summary"]),
        source=str(record["source"]),
    )


def _view_record(view: View) -> dict[str, Any]:
    files = {"name": view.name, "image": view.image, "mask": view.mask, "split": view.split}
    return {**files, **camera_record(view.camera)}


def _view_from_record(record: dict[str, Any]) -> View:
    camera = camera_from_record(record)
    if record["split"] not in ("train", "test"):
        raise ValueError(f"split {record['split']!r}")
    return View(record["name"], camera, record["split"], record["image"], record["mask"])


def camera_record(camera: Camera) -> dict[str, Any]:
    """A camera as JSON holds it."""
    return {
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "R": camera.R.tolist(),
        "t": camera.t.tolist(),
    }


def camera_from_record(record: dict[str, Any]) -> Camera:
    """The camera of such a record.

    Raises:
        KeyError, TypeError, ValueError: the record is damaged.
    """
    return Camera(
        K=_array(record["K"], (3, 3)),
        R=_array(record["R"], (3, 3)),
        t=_array(record["t"], (3,)),
        width=int(record["width"]),
        height=int(record["height"]),
    )


def _array(values: Sequence[Any], shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"expected shape {shape}, got {array.shape}")
    return array


def _check_size(pixels: npt.NDArray[Any], camera: Camera, path: Path) -> None:
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise NmbgError(
            f"{path}: {width}×{height} pixels, scene.json says {camera.width}×{camera.height}; {_REMEDY}"
        )
