"""Pinhole cameras in COLMAP's convention (docs/conventions.md).

x right, y down, z forward; x_c = R x + t; pixel centres at +0.5; K in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nmbg.ops import pixel_rays, project, reference

Array = npt.NDArray[np.float64]

# Cameras surround their centre when what they look at lies within this share of the sphere's radius.
RING_SHARE = 0.6


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with its image size.

    Args:
        K: intrinsics, [3, 3] float64, pixels.
        R: world → camera rotation, [3, 3] float64.
        t: world → camera translation, [3] float64, scene units.
        width: image width in pixels.
        height: image height in pixels.
    """

    K: Array
    R: Array
    t: Array
    width: int
    height: int

    @property
    def centre(self) -> Array:
        """Camera centre −Rᵀ t in world coordinates, [3] float64."""
        centre: Array = -self.R.T @ self.t
        return centre

    @property
    def axis(self) -> Array:
        """Unit optical axis in world coordinates, [3] float64."""
        axis: Array = self.R[2]
        return axis

    @property
    def projection(self) -> Array:
        """K [R | t], [3, 4] float64: world point → homogeneous pixel (u·z, v·z, z)."""
        P: Array = self.K @ np.concatenate([self.R, self.t[:, None]], axis=1)
        return P

    def scaled(self, sx: float, sy: float, width: int, height: int) -> Camera:
        """The same view with pixels rescaled by (sx, sy), for an image of width × height."""
        return replace(self, K=np.diag([sx, sy, 1.0]) @ self.K, width=width, height=height)

    def resized(self, width: int, height: int) -> Camera:
        """The same field of view on an image of width × height pixels."""
        return self.scaled(width / self.width, height / self.height, width, height)

    def within(self, longest: int) -> Camera:
        """The same field of view on at most `longest` pixels along the longer side; never enlarged."""
        scale = min(1.0, longest / max(self.width, self.height))
        if scale == 1:
            return self
        return self.resized(max(1, round(scale * self.width)), max(1, round(scale * self.height)))

    def level(self, k: int) -> Camera:
        """Pyramid level k: diag(2⁻ᵏ, 2⁻ᵏ, 1) P on an image of ⌈size / 2ᵏ⌉ pixels."""
        step = 2**k
        return self.scaled(1 / step, 1 / step, -(-self.width // step), -(-self.height // step))

    def cropped(self, x0: float, y0: float, width: int, height: int) -> Camera:
        """The window of width × height pixels whose corner stands at (x0, y0); it may leave the image."""
        shift = np.array([[1.0, 0.0, -x0], [0.0, 1.0, -y0], [0.0, 0.0, 1.0]])
        return replace(self, K=shift @ self.K, width=width, height=height)

    def padded(self, multiple: int) -> Camera:
        """The view extended to the right and below to sizes that `multiple` divides."""
        return self.cropped(
            0, 0, -(-self.width // multiple) * multiple, -(-self.height // multiple) * multiple
        )

    def looking_at(self, target: Array, place: Array, up: Array) -> Camera:
        """A camera with these intrinsics and this image size, upright.

        Args:
            target: on its optical axis, [3].
            place: its centre, [3].
            up: unit up axis, [3]; not along the optical axis.
        """
        z = (target - place) / np.linalg.norm(target - place)
        x = np.cross(z, up)
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        return replace(self, R=R, t=-R @ place)

    def project(self, points: Tensor) -> Tensor:
        """Homogeneous pixel coordinates (u·z, v·z, z) of world points.

        Args:
            points: [N, 3] float32 or float64, scene units.

        Returns:
            [N, 3] in the dtype of `points`; computed in float64, so that far-away origins lose nothing.
        """
        op = project if points.device.type == "cpu" else reference.project
        return op(points, torch.from_numpy(self.projection))

    def warp_to(self, other: Camera) -> Array:
        """[B | c], [3, 4] float64: pixel (x, y) at depth z lies at z·B·(x, y, 1) + c in the other camera."""
        B = other.R @ self.R.T @ np.linalg.inv(self.K)
        c = other.R @ self.centre + other.t
        warp: Array = np.concatenate([B, c[:, None]], axis=1)
        return warp

    def rays(self, dtype: torch.dtype = torch.float32) -> Tensor:
        """Unit world-space directions through the pixel centres, [H, W, 3]."""
        M = torch.from_numpy(self.R.T @ np.linalg.inv(self.K))
        return pixel_rays(M, self.height, self.width, dtype)


def nearest_point_to_axes(cameras: list[Camera]) -> Array:
    """Least-squares point nearest to all optical axes, [3] float64.

    Where the axes do not tell (parallel, or nearly so: within some two degrees), the point keeps the place of
    the mean camera centre.
    """
    centres = np.stack([c.centre for c in cameras])
    mean = centres.mean(0)
    projectors = np.stack([np.eye(3) - np.outer(c.axis, c.axis) for c in cameras])
    rhs = np.einsum("nij,nj->i", projectors, centres - mean)
    offset: Array = np.linalg.lstsq(projectors.sum(0), rhs, rcond=1e-3)[0]
    point: Array = mean + offset
    return point


def up_axis(cameras: list[Camera]) -> Array:
    """Unit up axis: minus the mean of the cameras' y axes, [3] float64."""
    up = -np.stack([c.R[1] for c in cameras]).mean(0)
    norm = np.linalg.norm(up)
    unit: Array = up / norm if norm > 1e-9 else -cameras[0].R[1]
    return unit


@dataclass(frozen=True, eq=False)
class Sphere:
    """The foreground sphere.

    Args:
        centre: [3] float64.
        radius: scene units.
        ring: whether the cameras surround what they look at, so that the sphere separates near from far.
    """

    centre: Array
    radius: float
    ring: bool


def foreground_sphere(cameras: list[Camera]) -> Sphere:
    """Sphere around the training cameras: their mean centre and 1.1 times the largest distance from it.

    Where what they look at (the point nearest to all optical axes) lies far from that centre, the cameras are
    no ring and their mean lies among them: that point is the centre then.
    """
    centres = np.stack([camera.centre for camera in cameras])
    focus = nearest_point_to_axes(cameras)
    mean = centres.mean(0)
    radius = 1.1 * float(np.linalg.norm(centres - mean, axis=1).max())
    if np.linalg.norm(focus - mean) <= RING_SHARE * radius:
        return Sphere(mean, radius, ring=True)
    return Sphere(focus, 1.1 * float(np.linalg.norm(centres - focus, axis=1).max()), ring=False)
