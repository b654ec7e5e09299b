"""Many views of one scene, reduced and stacked: any point is looked up in all of them at once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.images import Image, Mask
from nmbg.sight import Sight


@dataclass(frozen=True, eq=False)
class Lookup:
    """Where points fall in views.

    Args:
        inside: [V, N] bool, in front of the camera, inside its image and inside its mask.
        z: [V, N] float32 view-space depth of the points, scene units.
        surface: [V, N] float32 depth of what the view sees there, infinite where it sees no surface.
        uv: [V, N, 2] float64 pixels; meaningless where not inside.
        pixel: [V, N] int64, row-major index of the (padded) pixel, 0 where not inside.
    """

    inside: Tensor
    z: Tensor
    surface: Tensor
    uv: Tensor
    pixel: Tensor

    def visible(self, tolerance: float) -> Tensor:
        """Whether each point stands no further behind the view's surface than this share of it, [V, N]."""
        return self.inside & (self.z < (1 + tolerance) * self.surface)


@dataclass(frozen=True, eq=False)
class Gallery:
    """Photographs with the depth of what they show; images smaller than the largest are padded.

    Args:
        cameras: one per view, at the size of its image below.
        images: [V, H, W, 3] uint8.
        inside: [V, H, W] bool, inside image and mask.
        depth: [V, H, W] float32 view-space z, scene units; infinite where no surface is seen.
    """

    cameras: tuple[Camera, ...]
    images: Tensor
    inside: Tensor
    depth: Tensor

    @staticmethod
    def hang(sights: Sequence[Sight], images: Iterable[Image], masks: Sequence[Mask]) -> Gallery:
        """Stack views: images [h, w, 3] uint8, read one at a time, are averaged down to the sights' sizes.

        Masks [H, W] bool have these sizes already.
        """
        height = max(sight.camera.height for sight in sights)
        width = max(sight.camera.width for sight in sights)
        stacked = torch.zeros(len(sights), height, width, 3, dtype=torch.uint8)
        inside = torch.zeros(len(sights), height, width, dtype=torch.bool)
        depth = torch.full((len(sights), height, width), torch.inf)
        for i, (sight, image, mask) in enumerate(zip(sights, images, masks, strict=True)):
            rows, columns = slice(sight.camera.height), slice(sight.camera.width)
            # torch has no average over bytes; OpenImageIO's filter would take most of the closing's time.
            full = torch.from_numpy(image).permute(2, 0, 1).float()
            small = F.adaptive_avg_pool2d(full, (sight.camera.height, sight.camera.width))
            stacked[i, rows, columns] = small.permute(1, 2, 0).round().byte()
            inside[i, rows, columns] = torch.from_numpy(mask)
            depth[i, rows, columns] = torch.where(sight.covered, sight.depth, torch.inf)
        return Gallery(tuple(sight.camera for sight in sights), stacked, inside, depth)

    def __len__(self) -> int:
        return len(self.cameras)

    def part(self, chosen: Sequence[int]) -> Gallery:
        """Only the chosen views, in that order."""
        index = torch.tensor(list(chosen), dtype=torch.long)
        cameras = tuple(self.cameras[i] for i in chosen)
        return Gallery(cameras, self.images[index], self.inside[index], self.depth[index])

    def before(self, sights: Sequence[Sight]) -> Gallery:
        """The same photographs with more surfaces in the scene: the nearer depth counts."""
        depth = self.depth.clone()
        for i, sight in enumerate(sights):
            window = depth[i, : sight.camera.height, : sight.camera.width]
            torch.minimum(window, torch.where(sight.covered, sight.depth, torch.inf), out=window)
        return replace(self, depth=depth)

    def view(self, i: int) -> tuple[Camera, Tensor, Tensor, Tensor]:
        """Camera, image [h, w, 3] uint8, inside [h, w] and depth [h, w] of one view, without padding."""
        camera = self.cameras[i]
        rows, columns = slice(camera.height), slice(camera.width)
        return (
            camera,
            self.images[i, rows, columns],
            self.inside[i, rows, columns],
            self.depth[i, rows, columns],
        )

    def most_alike(self, i: int, n: int) -> list[int]:
        """The n other views whose axes point most as this one's does; of equal ones, the nearest."""
        own = self.cameras[i]
        axes = np.stack([camera.axis for camera in self.cameras])
        distance = np.linalg.norm(np.stack([camera.centre for camera in self.cameras]) - own.centre, axis=1)
        order = np.lexsort((distance, -(axes @ own.axis).round(6)))
        return [int(j) for j in order if j != i][:n]

    def open(self, i: int) -> Tensor:
        """Pixels of a view that count but see no surface, [h, w] bool."""
        _, _, inside, depth = self.view(i)
        return inside & depth.isinf()

    def look_up(self, points: Tensor) -> Lookup:
        """Find world points [N, 3] in every view."""
        P = torch.from_numpy(np.stack([camera.projection for camera in self.cameras]))
        h = torch.einsum("vij,nj->vni", P[..., :3], points.double()) + P[:, None, :, 3]
        z = h[..., 2]
        front = z > 1e-9
        uv = h[..., :2] / torch.where(front, z, 1.0)[..., None]
        size = torch.tensor([[camera.width, camera.height] for camera in self.cameras])
        inside = front & (uv >= 0).all(-1) & (uv < size[:, None]).all(-1)
        column, row = torch.where(inside[..., None], uv, 0.0).long().unbind(-1)
        pixel = row * self.depth.shape[2] + column
        inside &= self.inside.flatten(1).gather(1, pixel)
        return Lookup(inside, z.float(), self.depth.flatten(1).gather(1, pixel), uv, pixel)

    def colours(self, found: Lookup) -> Tensor:
        """What each view shows in the pixel of each point, [V, N, 3] uint8."""
        return self.images.flatten(1, 2).gather(1, found.pixel[..., None].expand(-1, -1, 3))
