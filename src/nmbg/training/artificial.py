"""Cameras that took no photograph: where the discriminator alone judges renders (paper, section 3.4).

Around a ring of cameras they stand in the shell about the sphere's centre, at the elevations of the
training cameras, and look at it (after RegNeRF). Of other captures they stand between neighbouring training
cameras and look at the focus point. None stands inside or behind the geometry.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import torch

from nmbg.cameras import Camera, foreground_sphere
from nmbg.errors import NmbgError
from nmbg.scene import Scene, evenly
from nmbg.sight import Sight, look

Array = npt.NDArray[np.float64]

# The shell, shares of the sphere's radius; elevations, standard deviations around their mean (paper).
SHELL = (0.6, 1.0)
DEVIATIONS = 1.5
# Never nearer to the pole: there the up axis says nothing.
STEEPEST = math.radians(80)
# Captures that are no ring: neighbours between which a camera stands, and how far it is pushed aside, as a
# share of their distance.
NEIGHBOURS = 4
ASIDE = 0.25
# Side of the images in which places are judged, and so many training views tell what is normal.
SIGHT_SIZE = 96
JUDGES = 24
# A place may see this share more of backs, and this share less of surface, than the worst training view.
TOLERANCE = 0.1
# It may come as near to the surface as this share of the nearest that a training view comes.
NEARNESS = 0.5
# Draws before a training camera stands in.
TRIES = 32


class ArtificialCameras:
    """Draws cameras around a scene.

    Args:
        scene: its training views and geometry are looked at.

    Raises:
        NmbgError: all training cameras stand at one place.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.radius == 0:
            raise NmbgError(
                f"{scene.folder}: all training cameras stand at one place; give --artificial-views 0"
            )
        self.scene = scene
        self.cameras = [view.camera for view in scene.train]
        self._centres = np.stack([camera.centre for camera in self.cameras])
        self.ring = foreground_sphere(self.cameras).ring
        self._axes = frame(scene.up)
        away = self._centres - scene.centre
        distance = np.linalg.norm(away, axis=1).clip(min=1e-12)
        elevation = np.arcsin((away @ scene.up / distance).clip(-1, 1))
        spread = DEVIATIONS * elevation.std()
        self.elevations = tuple(
            np.clip([elevation.mean() - spread, elevation.mean() + spread], -STEEPEST, STEEPEST)
        )
        self._seen = [look(scene.mesh, c.within(SIGHT_SIZE)) for c in evenly(self.cameras, JUDGES)]
        facts = np.array([self._facts(sight) for sight in self._seen])
        # Which side of faces is the outer one is for the mesh's maker to say: it is the one that views see.
        self._inside_out = facts[:, 1].mean() > 0.5
        backs = np.abs(facts[:, 1] - float(self._inside_out))
        self._least_covered = facts[:, 0].min() - TOLERANCE
        self._most_backs = backs.max() + TOLERANCE
        self._nearest = NEARNESS * facts[:, 2].min()

    def draw(self, generator: torch.Generator) -> Camera:
        """A camera with the intrinsics of a random training view; a training camera where none fits in."""
        for _ in range(TRIES):
            like = self.cameras[_integer(len(self.cameras), generator)]
            place = self._in_shell(generator) if self.ring else self._between(generator)
            camera = like.looking_at(self.scene.centre, place, self.scene.up)
            if self.admits(camera):
                return camera
        return self.cameras[_integer(len(self.cameras), generator)]

    def admits(self, camera: Camera) -> bool:
        """Whether a camera sees the geometry as training views do: from outside, before it, not too near."""
        sight = look(self.scene.mesh, camera.within(SIGHT_SIZE))
        covered, backs, nearest = self._facts(sight)
        return bool(
            covered >= self._least_covered
            and abs(backs - float(self._inside_out)) <= self._most_backs
            and nearest >= self._nearest
            and not self._hidden(camera.centre)
        )

    def _in_shell(self, generator: torch.Generator) -> Array:
        """Paper, section 3.4: r ~ U[0.6 r, r], azimuth ~ U[0, 2π], elevation ~ U[mean ± 1.5 σ]."""
        r, azimuth, height = torch.rand(3, generator=generator).tolist()
        r = self.scene.radius * (SHELL[0] + (SHELL[1] - SHELL[0]) * r)
        low, high = self.elevations
        elevation, azimuth = low + (high - low) * height, 2 * math.pi * azimuth
        direction = np.array(
            [
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
                math.cos(elevation) * math.cos(azimuth),
            ]
        )
        place: Array = self.scene.centre + r * direction @ self._axes
        return place

    def _between(self, generator: torch.Generator) -> Array:
        """A place between a training camera and one of its neighbours, pushed a little aside."""
        start = self._centres[_integer(len(self._centres), generator)]
        distance = np.linalg.norm(self._centres - start, axis=1)
        near = distance.argsort(kind="stable")[1 : NEIGHBOURS + 1]
        share = float(torch.rand((), generator=generator))
        push = torch.randn(3, generator=generator, dtype=torch.float64).numpy()
        if not len(near):
            return np.asarray(start)
        other = near[_integer(len(near), generator)]
        between: Array = start + share * (self._centres[other] - start)
        between += ASIDE * distance[other] * push
        return between

    def _facts(self, sight: Sight) -> tuple[float, float, float]:
        """Of a sight: the share of covered pixels, of these the share that see backs, the least depth."""
        covered = sight.covered
        if not covered.any():
            return 0.0, 0.0, 0.0
        seen = sight.face[covered].numpy()
        # The far shell has no inside to be in.
        faces = self.scene.mesh.faces[seen[seen < len(self.scene.mesh.faces) - self.scene.shell_faces]]
        a, b, c = self.scene.mesh.vertices[faces].astype(np.float64).transpose(1, 0, 2)
        facing = (np.cross(b - a, c - a) * (sight.camera.centre - a)).sum(1)
        return (
            float(covered.float().mean()),
            float((facing < 0).sum()) / len(seen),
            float(sight.depth[covered].min()),
        )

    def _hidden(self, place: Array) -> bool:
        """Whether every training view that would see a place sees a surface before it."""
        looked_at = False
        for sight in self._seen:
            x, y, z = sight.camera.projection @ np.append(place, 1.0)
            column, row = (int(x / z), int(y / z)) if z > 0 else (-1, -1)
            if 0 <= column < sight.camera.width and 0 <= row < sight.camera.height:
                if not sight.covered[row, column] or z < sight.depth[row, column]:
                    return False
                looked_at = True
        return looked_at


def frame(up: Array) -> Array:
    """World axes whose second is the pole `up`, a unit vector: [3, 3], rows right, up, forward."""
    right = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    right /= np.linalg.norm(right)
    return np.stack([right, up, np.cross(right, up)])


def _integer(end: int, generator: torch.Generator) -> int:
    return int(torch.randint(end, (), generator=generator))
