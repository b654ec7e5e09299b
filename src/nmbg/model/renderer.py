"""Geometry, descriptors, photographs and network: a camera in, an image out."""

from __future__ import annotations

from collections.abc import Sequence, Set
from functools import partial
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.model.config import ModelConfig
from nmbg.model.descriptors import SH_CONSTANT, Descriptors
from nmbg.model.exposure import Exposures
from nmbg.model.fragments import LayerFragments, rasterize_finest, rasterize_layer
from nmbg.model.fusion import Fusion
from nmbg.model.photographs import NOTHING, Gathered, Photographs
from nmbg.model.unet import UNet
from nmbg.scene import Scene, View

# What a renderer turns into an image: fragments to shade, or what mesh and photographs show already; apart
# for a network, else as one image.
Prepared = list[LayerFragments] | Gathered | Tensor


class Renderer(nn.Module):
    """A scene that can be rendered.

    Args:
        config: the model.
        layers: one mesh per layer, foreground first.
        network: of another renderer of this model, to be shared with it; otherwise a new one is made.
    """

    def __init__(self, config: ModelConfig, layers: Sequence[Mesh], network: nn.Module | None = None) -> None:
        super().__init__()
        if len(layers) != config.layers:
            raise ValueError(f"expected {config.layers} layers, got {len(layers)}")
        self.config = config
        self.layers = tuple(layers)
        self.descriptors = nn.ModuleList(Descriptors(len(mesh.vertices), config) for mesh in layers)
        self.photographs: Photographs | None = None
        # Of training photographs; photographs that are blended know their own.
        self.exposures: Exposures | None = None
        # Whether render() runs the network in bfloat16, which changes a view by about what bytes round off.
        self.bf16 = False
        self.network = make_network(config) if network is None else network

    @property
    def _descriptors(self) -> list[Descriptors]:
        return cast("list[Descriptors]", list(self.descriptors))

    @property
    def _device(self) -> torch.device:
        return self._descriptors[0].coeffs.device

    @torch.no_grad()
    def set_colours(self, coeffs: Sequence[Tensor]) -> None:
        """Start the colour features from coefficients [N, B′, 3] per layer, colours in [0, 1]."""
        for descriptors, layer in zip(self._descriptors, coeffs, strict=True):
            descriptors.set_colours(_centred(layer))

    def degrees(self) -> list[Tensor]:
        """Highest degree of each vertex whose coefficients are not all zero, [N] int64 per layer."""
        return [descriptors.degrees() for descriptors in self._descriptors]

    def remember(self, scene: Scene, views: Sequence[View], cache_gib: float = 4.0) -> None:
        """Blend these photographs of the scene over the mesh from now on; so many GiB are kept ready."""
        self.photographs = Photographs(
            scene, views, partial(coloured, [self]), self.config.sources, cache_gib
        )

    def see(self, camera: Camera, without: Set[str] = NOTHING) -> Prepared:
        """What forward() needs of a view.

        Args:
            camera: the view.
            without: names of the photographs that must not be blended in.
        """
        if self.photographs is None:
            return self.rasterize(camera, once=True)
        colour, depth = self.on_mesh(camera)
        # Of nothing at all, a network would show its borders.
        alone = self.network is None or not depth.any()
        blend = self.photographs.over if alone else self.photographs.gather
        return blend(camera, colour, depth, without)

    def padded(self, camera: Camera) -> Camera:
        """The view extended so that the pyramid's sizes are whole."""
        return camera.padded(2 ** (self.config.levels - 1))

    def on_mesh(self, camera: Camera) -> tuple[Tensor, Tensor]:
        """Colour [3, H, W] and depth [H, W] of the one layer that photographs are blended over."""
        (colour,), depth = coloured([self], camera)
        return colour, depth

    def rasterize(self, camera: Camera, once: bool = False) -> list[LayerFragments]:
        """What `camera` sees of each layer, padded; `once` where it is not kept."""
        radius = self.config.radius_px(camera.width, camera.height)
        return [rasterize_layer(mesh, self.padded(camera), self.config, radius, once) for mesh in self.layers]

    def colour(self, fragments: list[LayerFragments], camera: Camera) -> Tensor:
        """The colour on the mesh without the network, [3, H, W]; the foreground hides the background."""
        images = [d.pyramid(layer, 1)[0] for d, layer in zip(self._descriptors, fragments, strict=True)]
        image, s = images[-1], self.config.supersample
        for nearer, layer in zip(images[-2::-1], fragments[-2::-1], strict=True):
            face = layer.levels[0].face
            assert face is not None
            covered = (face >= 0).float()[None, None].to(image.device)
            image = nearer + (1 - (F.avg_pool2d(covered, s) if s > 1 else covered)) * image
        return image[0, :, : camera.height, : camera.width] + 0.5

    def forward(self, sight: Prepared, camera: Camera) -> Tensor:
        """Render what `see(camera)` gave, [3, H, W], about [0, 1] but not clamped."""
        if isinstance(sight, Gathered):
            return self._fuse(sight) if self.network is not None else sight.blended()
        if isinstance(sight, Tensor):
            return sight
        if self.network is None:
            return self.colour(sight, camera)
        levels = self.config.levels
        pyramids = [d.pyramid(layer, levels) for d, layer in zip(self._descriptors, sight, strict=True)]
        image: Tensor = self.network(
            [[x.contiguous(memory_format=torch.channels_last) for x in p] for p in pyramids]
        )
        return image[0, :, : camera.height, : camera.width].float() + 0.5

    def _fuse(self, gathered: Gathered) -> Tensor:
        """Mesh and photographs as one image; the network re-weights the photographs and adds to them."""
        assert self.network is not None
        gathered = gathered.to(self._device)
        # In the network's precision and layout at once: on its own, autocast would copy them a second time.
        device = self._device.type
        enabled = torch.is_autocast_enabled(device)
        dtype = torch.get_autocast_dtype(device) if enabled else torch.float32
        features = gathered.features()[None].to(dtype, memory_format=torch.channels_last)
        added, preference = self.network(features)
        weights = gathered.weights.float() * preference.exp()
        weights = weights / weights.sum(0).clamp(min=1e-6)
        residual = (gathered.shown.float() * weights[:, None]).sum(0)
        image: Tensor = gathered.base.float() + residual + added
        return image

    @torch.no_grad()
    def render(self, camera: Camera, without: Set[str] = NOTHING) -> Tensor:
        """A new view, [3, H, W] float32 in [0, 1] on the CPU; any camera, any size.

        It is exposed as the photographs around it were, where these are known to differ.

        Args:
            camera: the view.
            without: names of the photographs that must not be blended in, as the one this view is compared
                with.
        """
        training = self.training
        self.eval()
        try:
            sight = self.see(camera, without)
            # As in see().
            nothing = isinstance(sight, list) and all(layer.empty for layer in sight)
            grey = torch.full((3, camera.height, camera.width), 0.5)
            with torch.autocast(self._device.type, torch.bfloat16, enabled=self.bf16):
                image: Tensor = grey if nothing else self(sight, camera)
        finally:
            self.train(training)
        if self.exposures is not None:
            image = self.exposures.around(camera.centre, without).apply(image.cpu())
        return image.clamp(0, 1).cpu()


@torch.no_grad()
def coloured(renderers: Sequence[Renderer], camera: Camera) -> tuple[list[Tensor], Tensor]:
    """Colours [3, H, W] of renderers that differ in their descriptors alone, and the depth [H, W] of all."""
    first = renderers[0]
    (mesh,) = first.layers
    fragments = rasterize_finest(mesh, camera, first.config)
    assert fragments.depth is not None
    return [renderer.colour([fragments], camera).cpu() for renderer in renderers], fragments.depth


def make_network(config: ModelConfig) -> Fusion | UNet | None:
    """The network of a model with random weights; None where the model has none."""
    if not config.widths:
        return None
    network = (
        Fusion(config.sources, config.widths)
        if config.sources
        else UNet(config.layers, config.channels, config.widths)
    )
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def _centred(coeffs: Tensor) -> Tensor:
    """Colour − ½ from colour, [N, B, 3]: an empty pixel, whose features are zero, is mid-grey."""
    shifted = coeffs.clone()
    shifted[:, 0] -= 0.5 / SH_CONSTANT
    return shifted
