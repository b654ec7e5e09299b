"""The photographs as memory: what they show that the mesh does not, blended into any view.

What is blended are residuals, photograph − colour on the mesh as the photograph's own camera sees it; its
exposure is undone before. Where the mesh shows too little they add it, and where no photograph sees the
surface the mesh's colour remains. The whole is exposed as the photographs around the view are.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from nmbg.blending import blend_into
from nmbg.cameras import Camera
from nmbg.images import from_bytes
from nmbg.model.cover import SourceCover
from nmbg.model.exposure import Exposure, fit_exposure, mean_exposure, neighbours
from nmbg.ops import Blend, mip_chain
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View

# A view is blended from this many photographs at most: with twenty, one capture gained 0.04 dB.
CANDIDATES = 14
# Score of the best source at which residuals count half: below it the mesh is trusted more.
HALF_TRUST = 1e-4
GIB = 2**30
NOTHING: Set[str] = frozenset()


@dataclass(frozen=True)
class Gathered:
    """What mesh and photographs show of a view; nothing here is trained by gradients.

    Args:
        base: [3, H, W] float16, colour on the mesh.
        shown: [K, 3, H, W] float16, residuals of the K best photographs, times `trust`.
        weights: [K, H, W] float16, their weights; they sum to one, or are 0.
        trust: [H, W] float16 in [0, 1]: whether any photograph sees the point.
        score: [H, W] float16 in [0, 1], of the best photograph.
    """

    base: Tensor
    shown: Tensor
    weights: Tensor
    trust: Tensor
    score: Tensor

    @property
    def _parts(self) -> tuple[Tensor, ...]:
        return self.base, self.shown, self.weights, self.trust, self.score

    @property
    def nbytes(self) -> int:
        """Memory held, bytes."""
        return sum(part.nbytes for part in self._parts)

    def to(self, device: torch.device) -> Gathered:
        """The same on another device."""
        return Gathered(*(part.to(device) for part in self._parts))

    def cropped(self, x0: int, y0: int, width: int, height: int) -> Gathered:
        """The window of width × height pixels whose corner stands at (x0, y0), a view of the same memory."""
        rows, columns = slice(y0, y0 + height), slice(x0, x0 + width)
        return Gathered(*(part[..., rows, columns] for part in self._parts))

    def blended(self) -> Tensor:
        """Mesh and photographs without a network, [3, H, W] float32."""
        residual = (self.shown.float() * self.weights.float()[:, None]).sum(0)
        return self.base.float() + residual

    def features(self) -> Tensor:
        """What a network may read, [features, H, W] float32, each scaled to deviate by about one.

        See `count_features`.
        """
        colours = [4 * (self.blended() - 0.5), 4 * (self.base.float() - 0.5), 16 * self.shown.flatten(0, 1)]
        parts = [*colours, 4 * self.weights, self.trust[None], self.score[None]]
        return torch.cat([part.float() for part in parts])


def count_features(sources: int) -> int:
    """Channels of Gathered.features() for K = `sources`."""
    return 3 + 3 + 3 * sources + sources + 2


def _trust(weight: Tensor) -> Tensor:
    return weight / (weight + HALF_TRUST)


class Source(NamedTuple):
    """A photograph ready to be blended.

    Args:
        texels: per colouring of the mesh, [texels, 3] uint8, mip chain of ½ + residual / 2.
        depth: [h, w] float32 view-space z of the surface, 0 where none is seen or the mask leaves it out.
        exposures: of the photograph, per colouring.
    """

    texels: list[Tensor]
    depth: Tensor
    exposures: list[Exposure]

    @property
    def nbytes(self) -> int:
        """Memory held, bytes."""
        return self.depth.nbytes + sum(texels.nbytes for texels in self.texels)


# Camera → what it sees of the mesh: the colour that residuals are taken from, [3, H, W], per colouring, and
# view-space z [H, W], 0 where the mesh is not seen; float32.
OnMesh = Callable[[Camera], tuple[Sequence[Tensor], Tensor]]


class Photographs:
    """Training photographs ready to be blended, prepared when they are first needed.

    The mesh may be coloured in several ways; a photograph is then prepared over all of them at once, as
    opening it and rasterizing its view is what costs most.

    Args:
        scene: gives photographs and geometry; must not be changed.
        views: which photographs.
        mesh: what their cameras see of the mesh.
        sources: K, photographs blended in a pixel.
        cache_gib: memory for prepared photographs, GiB; the least recently used are prepared anew.
    """

    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        mesh: OnMesh,
        sources: int,
        cache_gib: float = 4.0,
    ) -> None:
        self.scene, self.views, self.mesh, self.sources = scene, tuple(views), mesh, sources
        self._limit = int(cache_gib * GIB)
        self._held = 0
        self._cache: OrderedDict[int, Source] = OrderedDict()

    @property
    def nbytes(self) -> int:
        """Memory held by prepared photographs, bytes."""
        return self._held

    @cached_property
    def cover(self) -> SourceCover:
        """What decides which photographs a view is blended from."""
        return SourceCover(self.scene.mesh, [view.camera for view in self.views])

    def prepare(self) -> None:
        """Prepare photographs until the cache is full, so that no view has to wait for one."""
        with progress_bar() as bar:
            for i in bar.track(range(len(self.views)), description="preparing photographs"):
                if self._held + self._source(i).nbytes > self._limit:
                    break

    def recoloured(self, mesh: OnMesh) -> Photographs:
        """The same photographs over other colours of the same mesh."""
        other = Photographs(self.scene, self.views, mesh, self.sources, self._limit / GIB)
        other.cover = self.cover
        return other

    def over(self, camera: Camera, base: Tensor, depth: Tensor, without: Set[str] = NOTHING) -> Tensor:
        """The mesh with the photographs blended over it, as Gathered.blended() but not rounded.

        Args:
            camera: the view.
            base: [3, H, W] float32 colour on the mesh in this view.
            depth: [H, W] float32 view-space z of the mesh in this view, 0 where it is not seen.
            without: names of the photographs that must not be among the sources.

        Returns:
            [3, H, W] float32.
        """
        blend = self._blend(camera, depth, without, each=False)
        # Texels hold ½ + residual / 2. Where no photograph sees the point, there is no trust.
        colour = torch.addcmul(base, blend.colour.mul_(2).sub_(1), _trust(blend.weight))
        return self.exposure(camera, without).apply(colour)

    def gather(
        self, camera: Camera, base: Tensor, depth: Tensor, without: Set[str] = NOTHING, colouring: int = 0
    ) -> Gathered:
        """What a network needs to blend the photographs into a view; arguments as for over().

        `base` is the colour on the mesh in that colouring.
        """
        blend = self._blend(camera, depth, without, each=True, colouring=colouring)
        trust = _trust(blend.weight)
        exposure = self.exposure(camera, without, colouring)
        # A source that is not there shows 0 and must stay 0.
        residuals = blend.shown.mul_(2).sub_(1).mul_((blend.weights > 0)[:, None] * trust)
        return Gathered(
            exposure.apply(base).half(),
            (exposure.gain * residuals).half(),
            blend.weights.half(),
            trust.half(),
            blend.weight.half(),
        )

    def _blend(
        self, camera: Camera, depth: Tensor, without: Set[str], each: bool, colouring: int = 0
    ) -> Blend:
        chosen = self.candidates(camera, depth, without)
        sources = [self._source(i) for i in chosen]
        return blend_into(
            camera,
            depth,
            [self.views[i].camera for i in chosen],
            [source.texels[colouring] for source in sources],
            [source.depth for source in sources],
            self.sources,
            each,
        )

    def candidates(self, camera: Camera, depth: Tensor, without: Set[str] = NOTHING) -> list[int]:
        """Indices of the photographs that together show best what a view sees, in ascending order."""
        left_out = [i for i, view in enumerate(self.views) if view.name in without]
        return self.cover.choose(camera, depth, CANDIDATES, self.sources, left_out)

    def exposure(self, camera: Camera, without: Set[str] = NOTHING, colouring: int = 0) -> Exposure:
        """How a view is exposed: as the photographs around it."""
        others = [i for i, view in enumerate(self.views) if view.name not in without]
        centres = np.array([self.views[i].camera.centre for i in others]).reshape(-1, 3)
        near, weights = neighbours(camera.centre, centres)
        return mean_exposure([self._source(others[i]).exposures[colouring] for i in near], weights)

    def _source(self, i: int) -> Source:
        if i in self._cache:
            self._cache.move_to_end(i)
            return self._cache[i]
        source = self._prepare(self.views[i])
        self._held += source.nbytes
        while self._cache and self._held > self._limit:
            _, dropped = self._cache.popitem(last=False)
            self._held -= dropped.nbytes
        self._cache[i] = source
        return source

    def _prepare(self, view: View) -> Source:
        image = from_bytes(self.scene.load_image(view))
        colours, depth = self.mesh(view.camera)
        mask = self.scene.load_mask(view)
        keep = None if mask is None else torch.from_numpy(mask)
        depth = depth if keep is None else depth * keep
        exposures = [fit_exposure(image, colour, depth > 0) for colour in colours]
        texels = []
        for colour, exposure in zip(colours, exposures, strict=True):
            residual = (exposure.undo(image) - colour).permute(1, 2, 0)
            finest = ((0.5 + residual / 2).clamp(0, 1) * 255).round().to(torch.uint8)
            texels.append(mip_chain(finest, keep))
        return Source(texels, depth, exposures)
