"""What the demo's surfaces look like: solid textures, two lights, gloss, and a far landscape.

All colours are linear light in [0, 1] unless said otherwise. Patterns are functions of the position in space:
they are as sharp as the camera can see.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

DOME_RADIUS = 7.0
PANORAMA = (1024, 2048)  # finer than a photograph's pixels
SUN = (3.0, -3.6, 5.5)  # a lamp, not a star: its shadows and highlights move with the position
LAMP = (-4.5, 2.0, 3.5)


@dataclass(frozen=True)
class Material:
    """How a part looks.

    Args:
        albedo: positions relative to the part's centre [N, 3] → diffuse colour [N, 3].
        gloss: share of the highlights and of the mirrored surroundings, 0 for a matte surface.
        shininess: exponent of the highlights (Blinn).
    """

    albedo: Callable[[Tensor], Tensor]
    gloss: float
    shininess: float = 1.0


class Waves:
    """Smooth random patterns: sums of plane waves of random direction and phase.

    Args:
        generator: source of the random numbers.
        frequency: cycles per scene unit.
        count: number of waves.
    """

    def __init__(self, generator: torch.Generator, frequency: float, count: int = 8) -> None:
        direction = F.normalize(torch.randn(count, 3, generator=generator), dim=1)
        spread = 0.7 + 0.6 * torch.rand(count, 1, generator=generator)
        self.k = 2 * math.pi * frequency * spread * direction
        self.phase = 2 * math.pi * torch.rand(count, generator=generator)

    def __call__(self, points: Tensor) -> Tensor:
        """[N, 3] → [N], of mean 0 and variance 1."""
        return torch.sin(points @ self.k.T + self.phase).mean(1) * math.sqrt(2 * len(self.phase))


class Appearance:
    """The materials and the light of one demo scene.

    Args:
        seed: of the patterns.
    """

    def __init__(self, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)

        def waves(frequency: float, count: int = 8) -> Waves:
            return Waves(generator, frequency, count)

        broad, middle, fine = waves(0.5), waves(2.2), waves(22.0)
        self._panorama = self._painted(hills=waves(3.5, 6), clouds=waves(1.7))

        def terrace(p: Tensor) -> Tensor:
            stone = _mix((0.62, 0.5, 0.36), (0.33, 0.36, 0.4), _step(middle(p) + 0.8 * broad(p), 0.0, 0.35))
            stone = stone * (1 + 0.06 * fine(p))[:, None]
            tile = (p[:, :2] / 0.5).frac().abs()
            joint = torch.minimum(tile, 1 - tile).amin(1)
            parity = ((p[:, :2] / 0.5).floor().sum(1) % 2)[:, None]
            stone = stone * (0.72 + 0.45 * parity)
            return torch.where(joint[:, None] < 0.06, torch.tensor([0.14, 0.13, 0.12]), stone)

        def sphere(p: Tensor) -> Tensor:
            bands = torch.sin(14 * p[:, 2] + 1.4 * middle(p))
            colour = _mix((0.75, 0.12, 0.08), (0.9, 0.78, 0.55), _step(bands, 0.0, 0.05))
            return colour * (1 + 0.06 * fine(p))[:, None]

        def box(p: Tensor) -> Tensor:
            checks = (p / 0.144 + 0.5).floor().sum(1) % 2
            colour = _mix((0.07, 0.22, 0.42), (0.75, 0.72, 0.62), checks)
            return colour * (0.85 + 0.3 * _step(middle(p) + 0.2 * fine(p), 0.0, 0.2))[:, None]

        def torus(p: Tensor) -> Tensor:
            turn = torch.atan2(p[:, 1], p[:, 0])
            stripes = torch.sin(8 * turn + 12 * p[:, 2])
            return _mix((0.05, 0.3, 0.16), (0.85, 0.6, 0.1), _step(stripes, 0.3, 0.08))

        def knot(p: Tensor) -> Tensor:
            veins = 1 - (middle(p) + 0.15 * fine(p)).abs().mul(2.2).clamp(max=1)
            colour = _mix((0.35, 0.1, 0.4), (0.1, 0.35, 0.5), _step(p[:, 2] + 0.3 * broad(p), 0.0, 0.5))
            return _mix_colours(colour, torch.tensor([0.9, 0.85, 0.8]), veins**2)

        self.materials = {
            "terrace": Material(terrace, gloss=0.7, shininess=7),
            "sphere": Material(sphere, gloss=1.0, shininess=14),
            "box": Material(box, gloss=0.8, shininess=10),
            "torus": Material(torus, gloss=1.0, shininess=12),
            "knot": Material(knot, gloss=1.0, shininess=10),
        }

    def surface(
        self, name: str, local: Tensor, position: Tensor, normal: Tensor, eye: Tensor, sun: Tensor
    ) -> Tensor:
        """Light that leaves a surface towards the eye.

        Args:
            name: of the part.
            local: positions relative to the part's centre, [N, 3].
            position: [N, 3].
            normal: unit outward normals, [N, 3].
            eye: camera centre, [3].
            sun: share of the sun that is not in shadow, [N].

        Returns:
            [N, 3].
        """
        material = self.materials[name]
        view = F.normalize(eye - position, dim=1)
        ambient = 0.2 + 0.08 * normal[:, 2:]
        light = ambient * torch.tensor([0.85, 0.95, 1.1])
        shine = torch.zeros_like(position)
        lights = ((SUN, (1.05, 0.95, 0.8), sun), (LAMP, (0.16, 0.2, 0.28), torch.ones_like(sun)))
        for place, tint, share in lights:
            towards = F.normalize(torch.tensor(place) - position, dim=1)
            strength = share[:, None] * torch.tensor(tint)
            light = light + strength * (towards * normal).sum(1, keepdim=True).clamp(min=0)
            half = F.normalize(towards + view, dim=1)
            lobe = (half * normal).sum(1, keepdim=True).clamp(min=0) ** material.shininess
            shine = shine + strength * lobe
        colour = material.albedo(local) * light
        if material.gloss:
            facing = (view * normal).sum(1, keepdim=True).clamp(0, 1)
            mirrored = self.landscape(position, 2 * facing * normal - view)
            fresnel = 0.08 + 0.5 * (1 - facing) ** 4
            colour = colour + material.gloss * (1.2 * shine + fresnel * mirrored)
        return colour

    def landscape(self, origin: Tensor, direction: Tensor) -> Tensor:
        """The far dome, seen from `origin` [N, 3] or [3] along unit directions [N, 3] → [N, 3]."""
        along = (origin * direction).sum(-1, keepdim=True)
        distance = (along**2 + DOME_RADIUS**2 - (origin**2).sum(-1, keepdim=True)).sqrt() - along
        x, y, z = ((origin + distance * direction) / DOME_RADIUS).unbind(1)
        grid = torch.stack([torch.atan2(y, x) / math.pi, z.clamp(-1, 1).asin() * 2 / math.pi], 1)
        looked_up = F.grid_sample(
            self._panorama, grid[None, None], padding_mode="border", align_corners=False
        )
        return looked_up[0, :, 0].T

    def _painted(self, hills: Waves, clouds: Waves) -> Tensor:
        """The dome as a panorama [1, 3, H, W]: azimuth from −π to π, elevation from −π/2 to π/2."""
        height, width = PANORAMA
        azimuth = ((torch.arange(width) + 0.5) / width * 2 - 1) * math.pi
        elevation = ((torch.arange(height) + 0.5) / height * 2 - 1)[:, None] * math.pi / 2
        x, y = elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin()
        p = torch.stack([x, y, elevation.sin().expand_as(x)], -1).reshape(-1, 3)
        z = p[:, 2]
        colour = _mix((0.8, 0.72, 0.62), (0.2, 0.38, 0.68), (z / 0.6).clamp(0, 1) ** 0.6)
        colour = _mix_colours(
            colour, torch.tensor([0.95, 0.93, 0.9]), 0.4 * _step(clouds(p), 0.4, 1.6) * (z > 0)
        )
        ridges = (
            (0.11, 0.6, (0.58, 0.59, 0.6)),
            (0.05, 1.0, (0.45, 0.5, 0.46)),
            (-0.02, 1.6, (0.36, 0.4, 0.27)),
        )
        for level, scale, tint in ridges:
            ridge = level + 0.035 * hills(p * torch.tensor([scale, scale, 0.0]) + level)
            shade = (1 + 0.12 * hills(p * scale))[:, None]
            colour = _mix_colours(colour, torch.tensor(tint) * shade, _step(ridge - z, 0.0, 0.06))
        return colour.T.reshape(1, 3, height, width)


def encode(light: Tensor) -> Tensor:
    """Linear light → sRGB in [0, 1]."""
    light = light.clamp(0, 1)
    return torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light.clamp(min=1e-4) ** (1 / 2.4) - 0.055)


def _step(x: Tensor, edge: float, width: float) -> Tensor:
    """Smooth step from 0 to 1 around `edge`."""
    t = ((x - edge) / width + 0.5).clamp(0, 1)
    return t * t * (3 - 2 * t)


def _mix(a: tuple[float, ...], b: tuple[float, ...], t: Tensor) -> Tensor:
    return _mix_colours(torch.tensor(a), torch.tensor(b), t)


def _mix_colours(a: Tensor, b: Tensor, t: Tensor) -> Tensor:
    return a + (b - a) * t[:, None]
