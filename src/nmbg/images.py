"""Photographs and masks as uint8 arrays: read, write, resize, undistort."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio
import torch
from torch import Tensor

from nmbg.colmap import pycolmap
from nmbg.errors import NmbgError

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".exr", ".heic"})
# Zero crossings of the Lanczos window to each side.
LOBES = 3
# Output rows that are resampled by one matrix product.
BLOCK = 32


def image_size(path: Path) -> tuple[int, int]:
    """Width and height from the file's header, as stored: an orientation tag is ignored, as COLMAP does."""
    file = _open(path)
    spec = file.spec()
    file.close()
    return spec.width, spec.height


def read_image(path: Path) -> Image:
    """Read a photograph, [H, W, 3] uint8; grey is repeated, alpha dropped, more than 8 bits are rounded.

    Raises:
        NmbgError: absent, no image, or truncated.
    """
    pixels = _read(path)
    return np.ascontiguousarray(
        pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1].repeat(3, axis=2)
    )


def read_mask(path: Path) -> Mask:
    """Read a mask, [H, W] bool: true where the first channel is at least half bright."""
    return np.ascontiguousarray(_read(path)[..., 0] >= 128)


def write_image(path: Path, image: npt.NDArray[np.uint8], quality: int | None = None) -> None:
    """Write [H, W, 3] or [H, W] uint8 in the format of the suffix.

    Args:
        path: where.
        image: what.
        quality: of JPEG XL, 1 to 100 (lossless).

    Raises:
        NmbgError: the file cannot be written.
    """
    pixels = np.ascontiguousarray(image if image.ndim == 3 else image[..., None])
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "uint8")
    # Twice as fast as the default level, for a few per cent of the size.
    spec.attribute("png:compressionLevel", 3)
    if quality is not None:
        spec.attribute("Compression", f"jpegxl:{quality}")
        # Beside the default of 7: a fifth to a tenth of the time; at high qualities nearer to the image, in
        # fewer bytes; lossless takes 4 % more.
        spec.attribute("jpegxl:effort", 3)
    out = oiio.ImageOutput.create(str(path))
    if out is None:
        raise NmbgError(f"{path}: unknown image format ({_one_line(oiio.geterror())}); use .png or .jpg")
    if not (out.open(str(path), spec) and out.write_image(pixels) and out.close()):
        raise NmbgError(f"{path}: cannot be written ({_one_line(out.geterror())}); is the disk full?")


def to_bytes(image: Tensor) -> Image:
    """[3, H, W] in about [0, 1], cut off there → [H, W, 3] uint8."""
    pixels: Image = (image.permute(1, 2, 0).clamp(0, 1) * 255).round().byte().contiguous().numpy()
    return pixels


def from_bytes(image: Image) -> Tensor:
    """[H, W, C] uint8 → [C, H, W] float32 in [0, 1]."""
    return torch.from_numpy(image).permute(2, 0, 1) / 255


def can_write(suffix: str) -> bool:
    """Whether OpenImageIO was built with this format."""
    return oiio.ImageOutput.create(f"image{suffix}") is not None


def resize(image: Image, width: int, height: int) -> Image:
    """Resample [H, W, C] with a Lanczos filter that widens with the reduction; image borders stay borders."""
    if image.shape[:2] == (height, width):
        return image
    upright = _lanczos(torch.from_numpy(image).float(), 0.0, image.shape[0] / height, height)
    out = _lanczos(upright.transpose(0, 1), 0.0, image.shape[1] / width, width).transpose(0, 1)
    resized: Image = out.round().clamp(0, 255).byte().contiguous().numpy()
    return resized


def resample(image: Tensor, left: float, top: float, step: float, width: int, height: int) -> Tensor:
    """A part of an image, resampled by the same filter.

    Args:
        image: [C, H, W] float32.
        left, top: its corner, pixels of the image.
        step: pixels of the image to one of the window's.
        width, height: of the window, pixels.

    Returns:
        [C, height, width] float32.
    """
    upright = _lanczos(image.permute(1, 2, 0), top, step, height)
    return _lanczos(upright.transpose(0, 1), left, step, width).permute(2, 1, 0)


def _lanczos(rows: Tensor, start: float, step: float, n: int) -> Tensor:
    """Resample [N, M, C] along the first axis to [n, M, C]: matrix products over the band of weights."""
    flat = rows.flatten(1)
    wider = max(1.0, step)
    out = []
    for block in torch.split((torch.arange(n, dtype=torch.float64) + 0.5) * step + start, BLOCK):
        first = max(0, int(block[0] - LOBES * wider))
        end = min(len(rows), int(block[-1] + LOBES * wider) + 1)
        x = (torch.arange(first, end) + 0.5 - block[:, None]) / wider
        weight = torch.where(x.abs() < LOBES, torch.sinc(x) * torch.sinc(x / LOBES), 0.0)
        out.append((weight / weight.sum(1, keepdim=True)).float() @ flat[first:end])
    return torch.cat(out).reshape(n, *rows.shape[1:])


def undistort(image: Image, lens: pycolmap.Camera) -> Image:
    """Resample [H, W, 3] uint8 as the pinhole camera of `undistorted_camera(lens)` would see it."""
    bitmap, _ = pycolmap.undistort_image(
        pycolmap.UndistortCameraOptions(), pycolmap.Bitmap.from_array(image), lens
    )
    array: Image = bitmap.to_array()
    return array


def undistorted_camera(lens: pycolmap.Camera) -> pycolmap.Camera:
    """The pinhole camera whose image lies wholly inside the distorted one: no black borders."""
    return pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), lens)


def _open(path: Path) -> oiio.ImageInput:
    if not path.is_file():
        raise NmbgError(f"{path}: no such image; restore it or give the right folder")
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise NmbgError(
            f"{path}: not a readable image ({_one_line(oiio.geterror())}); restore it from its source"
        )
    return file


def _read(path: Path) -> Image:
    file = _open(path)
    pixels: Any = file.read_image(0, 0, 0, file.spec().nchannels, "uint8")
    # A truncated JPEG comes back padded with grey, with the error only noted.
    error = file.geterror()
    file.close()
    if pixels is None or error:
        raise NmbgError(
            f"{path}: damaged or truncated image ({_one_line(error)}); restore it from its source"
        )
    return np.asarray(pixels, dtype=np.uint8)


def _one_line(text: str) -> str:
    return " ".join(text.split()) or "unknown error"
