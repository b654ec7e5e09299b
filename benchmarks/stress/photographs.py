"""Training photographs that are dark, tinted, noisy, blurred, squeezed, or of something else."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio
from scipy.ndimage import gaussian_filter

from nmbg.images import Image, read_image
from nmbg.scene import Scene
from stress.scenes import Random, Stress

# sRGB is nearly this power of linear light.
GAMMA = 2.2


def _to_bytes(values: npt.NDArray[np.floating]) -> Image:
    return values.round().clip(0, 255).astype(np.uint8)


def _with_gains(image: Image, stops: npt.NDArray[np.floating]) -> Image:
    """Each channel in linear light times 2^stops [3]."""
    return _to_bytes(image * 2 ** (stops / GAMMA))


def with_exposure(image: Image, severity: float, place: float, random: Random) -> Image:
    """Exposure drifts by up to so many stops to both sides, once to and fro over the capture."""
    return _with_gains(image, np.full(3, severity * np.sin(2 * np.pi * place)))


def with_white_balance(image: Image, severity: float, place: float, random: Random) -> Image:
    """Red and blue drift by up to so many stops against one another over the capture."""
    return _with_gains(image, severity * np.sin(2 * np.pi * place) * np.array([1, 0, -1]))


def with_noise(image: Image, severity: float, place: float, random: Random) -> Image:
    """Gaussian noise of this deviation, of 255."""
    return _to_bytes(image + severity * random.standard_normal(image.shape))


def with_blur(image: Image, severity: float, place: float, random: Random) -> Image:
    """A Gaussian blur of this deviation, a share of the longer side."""
    deviation = severity * max(image.shape)
    return _to_bytes(gaussian_filter(image.astype(np.float64), (deviation, deviation, 0), mode="nearest"))


def as_jpeg(image: Image, severity: float, place: float, random: Random) -> Image:
    """JPEG of a quality that is so much below 100."""
    if not severity:
        return image
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photograph.jpg"
        spec = oiio.ImageSpec(image.shape[1], image.shape[0], 3, "uint8")
        spec.attribute("compression", f"jpeg:{100 - severity:g}")
        out = oiio.ImageOutput.create(str(path))
        assert out.open(str(path), spec)
        assert out.write_image(image)
        assert out.close()
        return read_image(path)


def with_wrong_images(scene: Scene, severity: float, random: Random) -> Scene:
    """This share of the training views show one another's photographs."""
    train = scene.train
    chosen = random.permutation(len(train))[: round(severity * len(train))]
    other = {train[i].name: train[j] for i, j in zip(chosen, np.roll(chosen, 1), strict=True)}
    views = tuple(
        replace(v, image=other[v.name].image, mask=other[v.name].mask) if v.name in other else v
        for v in scene.views
    )
    return replace(scene, views=views)


PHOTOGRAPHS = (
    Stress("exposure", "photographs", "stops", (0, 0.25, 1, 2), image=with_exposure, drifts=True),
    Stress("white balance", "photographs", "stops", (0, 0.25, 0.5, 1), image=with_white_balance, drifts=True),
    Stress("noise", "photographs", "deviation, of 255", (0, 8, 25, 75), image=with_noise),
    Stress(
        "blur", "photographs", "deviation, share of the longer side", (0, 0.002, 0.006, 0.02), image=with_blur
    ),
    Stress("JPEG", "photographs", "100 − quality", (0, 50, 80, 95), image=as_jpeg),
    Stress("wrong images", "photographs", "share", (0, 0.05, 0.15, 0.4), with_wrong_images),
)
