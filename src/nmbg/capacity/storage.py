"""At which resolution and quality photographs are kept."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nmbg.capacity.judge import Limit
from nmbg.images import resize, write_image
from nmbg.scene import Scene, View


@dataclass(frozen=True)
class Storage:
    """How photographs are kept in a run.

    Args:
        quality: of JPEG XL, 1 to 100 (lossless); None keeps the files as they are.
        halvings: how often their sides are halved.
    """

    quality: int | None = None
    halvings: int = 0

    def __str__(self) -> str:
        size = f"1/{2**self.halvings} of the sides" if self.halvings else "full size"
        return f"{size}, {'as they are' if self.quality is None else f'JPEG XL {self.quality}'}"


# At equal bytes it costs left-out views less than WebP or JPEG: 0.055 dB at 1.9 MB on one capture, JPEG 0.10.
SUFFIX = ".jxl"
# Least first; the quality falls before the resolution does, as it costs less a byte.
STORAGES = (
    *(Storage(quality, halvings) for halvings in (2, 1) for quality in (75, 90)),
    *(Storage(quality) for quality in (75, 85, 90, 95, 97, 98, 99, 100)),
    Storage(),
)
# Where the search for the least that is enough begins.
USUAL = STORAGES.index(Storage(97))
# What the least storage may cost.
STORAGE_LIMIT = Limit(0.03, 0.016)


def store(scene: Scene, views: Sequence[View], folder: Path, storage: Storage) -> tuple[View, ...]:
    """Write photographs and masks of a scene below a folder.

    Args:
        scene: gives them.
        views: which.
        folder: gets images/ and masks/.
        storage: how.

    Returns:
        the views as they are stored.
    """
    (folder / "images").mkdir(parents=True, exist_ok=True)
    (folder / "masks").mkdir(exist_ok=True)
    return tuple(_store(scene, view, folder, storage) for view in views)


def _store(scene: Scene, view: View, folder: Path, storage: Storage) -> View:
    if storage.quality is None:
        shutil.copyfile(scene.folder / "images" / view.image, folder / "images" / view.image)
        if view.mask is not None:
            shutil.copyfile(scene.folder / "masks" / view.mask, folder / "masks" / view.mask)
        return view
    camera = view.camera.resized(
        *(max(1, side >> storage.halvings) for side in (view.camera.width, view.camera.height))
    )
    stored = replace(view, camera=camera, image=str(Path(view.image).with_suffix(SUFFIX)))
    image = resize(scene.load_image(view), camera.width, camera.height)
    write_image(folder / "images" / stored.image, image, quality=storage.quality)
    mask = scene.load_mask(view)
    if mask is not None and view.mask is not None:
        reduced = resize(mask[..., None].astype("uint8") * 255, camera.width, camera.height)
        stored = replace(stored, mask=str(Path(view.mask).with_suffix(".png")))
        write_image(folder / "masks" / str(stored.mask), reduced[..., 0])
    return stored


def stored_bytes(folder: Path) -> int:
    """Size of everything below a folder, bytes."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
