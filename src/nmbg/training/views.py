"""Training examples: what a view sees and what its photograph shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.images import resample
from nmbg.model.exposure import Exposure, Exposures
from nmbg.model.photographs import Gathered
from nmbg.model.renderer import Prepared
from nmbg.scene import Scene, View
from nmbg.training.shelf import Shelf


@dataclass(frozen=True)
class Example:
    """A camera, its fragments, and the photograph.

    Args:
        name: of the view.
        camera: the window that is trained on.
        sight: what the renderer needs of the view.
        image: [3, H, W] uint8; None of an artificial view.
        mask: [H, W] bool, or None when every pixel counts.
        exposure: of the photograph; None where all count as exposed alike.
    """

    name: str
    camera: Camera
    sight: Prepared
    image: Tensor | None
    mask: Tensor | None
    exposure: Exposure | None = None

    @property
    def nbytes(self) -> int:
        """Memory held, bytes."""
        parts = self.sight if isinstance(self.sight, list) else [self.sight]
        return sum(part.nbytes for part in (self.image, self.mask, *parts) if part is not None)


class Views:
    """Examples of a scene's views, kept where there is room, else made anew, with the same numbers.

    Args:
        scene: the scene.
        views: which of its views.
        see: camera of a view, or of a part of it, and the view → what the renderer needs of it.
        cache_gib: memory for whole-frame examples, GiB.
        folder: that takes those beyond it; None for memory alone.
        exposures: of training photographs, where they are known to differ.
    """

    def __init__(
        self,
        scene: Scene,
        views: tuple[View, ...],
        see: Callable[[Camera, View], Prepared],
        cache_gib: float,
        folder: Path | None = None,
        exposures: Exposures | None = None,
    ) -> None:
        self.exposures = exposures
        self.scene, self.views, self.see = scene, views, see
        self._shelf: Shelf[Example] = Shelf(cache_gib, folder)

    def __len__(self) -> int:
        return len(self.views)

    @property
    def nbytes(self) -> int:
        """Memory held by what is kept, bytes."""
        return self._shelf.nbytes

    @property
    def masked(self) -> bool:
        """Whether photographs have masks."""
        return any(view.mask for view in self.views)

    def photograph(self, i: int) -> tuple[Tensor, Tensor | None]:
        """The photograph of view i, [3, H, W] uint8, and its mask, [H, W] bool or None."""
        return self._load(self.views[i])

    def frame(self, i: int) -> Example:
        """The whole frame of view i."""
        kept = self._shelf.get(i)
        if kept is not None:
            return kept
        view = self.views[i]
        example = self._example(view, view.camera, *self._load(view))
        self._shelf.put(i, example, example.nbytes)
        return example

    def crop(self, i: int, share: float, generator: torch.Generator) -> Example:
        """A random window of the whole frame of view i, at whole pixels; for what photographs show alone.

        Args:
            i: view.
            share: the window's sides as a share of the image's.
            generator: source of the random numbers.
        """
        frame = self.frame(i)
        assert isinstance(frame.sight, Gathered)
        assert frame.image is not None
        width, height = (max(1, round(share * side)) for side in (frame.camera.width, frame.camera.height))
        x0 = int(torch.randint(frame.camera.width - width + 1, (), generator=generator))
        y0 = int(torch.randint(frame.camera.height - height + 1, (), generator=generator))
        rows, columns = slice(y0, y0 + height), slice(x0, x0 + width)
        return Example(
            frame.name,
            frame.camera.cropped(x0, y0, width, height),
            frame.sight.cropped(x0, y0, width, height),
            frame.image[:, rows, columns],
            None if frame.mask is None else frame.mask[rows, columns],
        )

    def window(self, i: int, share: float, zoom: tuple[float, float], generator: torch.Generator) -> Example:
        """A random window of view i, zoomed by a random factor.

        The camera moves with the window exactly, so photograph and geometry stay aligned to the pixel.

        Args:
            i: view.
            share: the window's sides as a share of the image's.
            zoom: least and largest size of the image that it is cut from, beside the photograph's.
            generator: source of the random numbers.
        """
        return self._example(self.views[i], *self.cut(i, share, zoom, generator))

    def cut(
        self, i: int, share: float, zoom: tuple[float, float], generator: torch.Generator
    ) -> tuple[Camera, Tensor, Tensor | None]:
        """Camera, photograph [3, H, W] uint8 and mask [H, W] bool of such a window."""
        view = self.views[i]
        moved, x0, y0, scale = random_window(view.camera, share, zoom, generator)
        part = (x0, y0, 1 / scale, moved.width, moved.height)
        image, mask = self._load(view)
        image = resample(image.float(), *part).round().clamp(0, 255).to(torch.uint8)
        if mask is not None:
            mask = resample(mask[None].float(), *part)[0] > 0.5
        return moved, image, mask

    def _load(self, view: View) -> tuple[Tensor, Tensor | None]:
        image = torch.from_numpy(self.scene.load_image(view)).permute(2, 0, 1).contiguous()
        mask = self.scene.load_mask(view)
        return image, None if mask is None else torch.from_numpy(mask)

    def _example(self, view: View, camera: Camera, image: Tensor, mask: Tensor | None) -> Example:
        found = self.exposures
        exposure = None if found is None else found.of(view.name, view.camera.centre)
        return Example(view.name, camera, self.see(camera, view), image, mask, exposure)


def random_window(
    camera: Camera, share: float, zoom: tuple[float, float], generator: torch.Generator
) -> tuple[Camera, float, float, float]:
    """A random window of a camera's image, zoomed by a random factor.

    Args:
        camera: the whole view.
        share: the window's sides as a share of the image's.
        zoom: least and largest size of the image that it is cut from, beside the camera's own; with zoom
            `share` it shows all of it.
        generator: source of the random numbers.

    Returns:
        the window's camera, its corner x, y in pixels of the image, and the zoom.
    """
    factor, fx, fy = torch.rand(3, generator=generator).tolist()
    least, largest = zoom
    scale = least + (largest - least) * factor
    width, height = max(1, round(share * camera.width)), max(1, round(share * camera.height))
    # A window of `size` pixels at `scale` covers size / scale pixels of the photograph.
    x0 = fx * (camera.width - width / scale)
    y0 = fy * (camera.height - height / scale)
    moved = camera.cropped(x0, y0, camera.width, camera.height).scaled(scale, scale, width, height)
    return moved, x0, y0, scale
