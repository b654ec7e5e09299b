"""One photograph on its way into a scene folder: undistorted, resized, its mask with it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from nmbg.cameras import Camera
from nmbg.errors import NmbgError
from nmbg.images import SUFFIXES, Image, image_size, read_image, read_mask, resize, undistort, write_image
from nmbg.importers.capture import Photo

# Formats that a scene folder may hold; photographs in others are converted.
KEPT_SUFFIXES = frozenset({".jpg", ".jpeg", ".png"})


def store_photograph(
    photo: Photo, mask: Path | None, folder: Path, stem: str, max_size: int | None
) -> tuple[Camera, str, str | None]:
    """Write a photograph below images/ and its mask below masks/, as the returned camera sees them.

    What needs no resampling is copied as it is; everything else is written as PNG, losslessly.

    Args:
        photo: the photograph.
        mask: its mask's file, of the photograph's size.
        folder: the scene folder.
        stem: the files' new name without suffix.
        max_size: longest side, pixels; None keeps the size.

    Returns:
        camera, image file, mask file (None without a mask).

    Raises:
        NmbgError: a file that cannot be read, or a mask of another size.
    """
    image = read_image(
        photo.path
    )  # also when it is only copied: a truncated file must show now, not in training
    camera = photo.camera if max_size is None else photo.camera.within(max_size)
    (folder / "images").mkdir(exist_ok=True)
    suffix = photo.path.suffix.lower()
    if photo.lens is None and camera is photo.camera and suffix in KEPT_SUFFIXES:
        name = stem + suffix
        shutil.copyfile(photo.path, folder / "images" / name)
    else:
        name = f"{stem}.png"
        write_image(folder / "images" / name, _as_seen(image, photo, camera))
    if mask is None:
        return camera, name, None

    if image_size(mask) != image.shape[1::-1]:
        wide, high = image_size(mask)
        raise NmbgError(
            f"{mask}: {wide}×{high} pixels, its image {photo.name} has {image.shape[1]}×{image.shape[0]}; "
            "give masks of the images' size"
        )
    (folder / "masks").mkdir(exist_ok=True)
    bright = read_mask(mask).astype("uint8")[..., None].repeat(3, axis=2) * 255
    write_image(
        folder / "masks" / f"{stem}.png",
        (_as_seen(bright, photo, camera)[..., 0] >= 128).astype("uint8") * 255,
    )
    return camera, name, f"{stem}.png"


def find_masks(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Match masks to images: `<name>.png` as COLMAP has it, the same stem, or the same number (3 and 03).

    Raises:
        NmbgError: no such folder, or an image without a mask.
    """
    if not folder.is_dir():
        raise NmbgError(f"{folder}: no such folder of masks; correct --masks")
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    by_key = {
        key: path for path in reversed(files) for key in _keys(path.relative_to(folder).with_suffix(""))
    }
    matched = {}
    for name in names:
        keys = [name, *_keys(Path(name).with_suffix(""))]
        mask = next((by_key[key] for key in keys if key in by_key), None)
        if mask is None:
            raise NmbgError(
                f"{folder}: no mask for image {name}; add one named after it, or leave out --masks"
            )
        matched[name] = mask
    return matched


def _keys(stem: Path) -> list[str]:
    """The path without suffix, and with its number freed of leading zeros."""
    number = str(int(stem.name)) if stem.name.isdecimal() else stem.name
    return list(dict.fromkeys([stem.as_posix(), stem.with_name(f"#{number}").as_posix()]))


def _as_seen(image: Image, photo: Photo, camera: Camera) -> Image:
    straight = image if photo.lens is None else undistort(image, photo.lens)
    return resize(straight, camera.width, camera.height)
