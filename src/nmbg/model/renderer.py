"""Geometry, descriptors and network: a camera in, an image out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.model.config import ModelConfig
from nmbg.model.descriptors import SH_CONSTANT, Descriptors
from nmbg.model.fragments import LayerFragments, rasterize_layer
from nmbg.model.unet import UNet


class Renderer(nn.Module):
    """A scene that can be rendered.

    Args:
        config: the model.
        layers: one mesh per layer, foreground first.
    """

    def __init__(self, config: ModelConfig, layers: Sequence[Mesh]) -> None:
        super().__init__()
        if len(layers) != config.layers:
            raise ValueError(f"expected {config.layers} layers, got {len(layers)}")
        self.config = config
        self.layers = tuple(layers)
        self.descriptors = nn.ModuleList(Descriptors(len(mesh.vertices), config) for mesh in layers)
        self.network = (
            UNet(config.layers, config.channels, config.widths, config.norm, zero_start=config.colour_skip)
            if config.widths
            else None
        )
        if self.network is not None:
            self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def _descriptors(self) -> list[Descriptors]:
        return cast("list[Descriptors]", list(self.descriptors))

    @torch.no_grad()
    def set_colours(self, coeffs: Sequence[Tensor]) -> None:
        """Start the colour features from coefficients [N, B′, 3] per layer, colours in [0, 1]."""
        for descriptors, layer in zip(self._descriptors, coeffs, strict=True):
            # Features are colour − ½: an empty pixel, whose features are zero, is mid-grey.
            shifted = layer.clone()
            shifted[:, 0] -= 0.5 / SH_CONSTANT
            descriptors.set_colours(shifted)

    def rasterize(self, camera: Camera) -> list[LayerFragments]:
        """What `camera` sees of each layer, padded so that the pyramid's sizes are whole."""
        padded = camera.padded(2 ** (self.config.levels - 1))
        return [rasterize_layer(mesh, padded, self.config) for mesh in self.layers]

    def colour(self, fragments: list[LayerFragments], camera: Camera) -> Tensor:
        """The colour on the mesh without the network, [3, H, W]; the foreground hides the background."""
        pyramids = [
            d.pyramid(layer, 1, slice(0, 3)) for d, layer in zip(self._descriptors, fragments, strict=True)
        ]
        return self._composite(pyramids, fragments)[0, :, : camera.height, : camera.width] + 0.5

    def forward(self, fragments: list[LayerFragments], camera: Camera) -> Tensor:
        """Render what `rasterize(camera)` gave, [3, H, W], about [0, 1] but not clamped."""
        if self.network is None:
            return self.colour(fragments, camera)
        pyramids = [
            d.pyramid(layer, self.config.levels, slice(None))
            for d, layer in zip(self._descriptors, fragments, strict=True)
        ]
        image: Tensor = self.network(
            [[x.contiguous(memory_format=torch.channels_last) for x in p] for p in pyramids]
        )
        if self.config.colour_skip:
            image = image + self._composite(pyramids, fragments)
        return image[0, :, : camera.height, : camera.width].float() + 0.5

    def _composite(self, pyramids: list[list[Tensor]], fragments: list[LayerFragments]) -> Tensor:
        """Finest colours of all layers, nearest layer first."""
        image = pyramids[-1][0][:, :3]
        for levels, layer in zip(pyramids[-2::-1], fragments[-2::-1], strict=True):
            face = layer.levels[0].face
            assert face is not None  # colour needs faces: ModelConfig
            covered = (face >= 0).float()[None, None].to(image.device)
            s = self.config.supersample
            alpha = F.avg_pool2d(covered, s) if s > 1 else covered
            image = levels[0][:, :3] + (1 - alpha) * image
        return image

    @torch.no_grad()
    def render(self, camera: Camera) -> Tensor:
        """A new view, [3, H, W] float32 in [0, 1] on the CPU; any camera, any size."""
        training = self.training
        self.eval()
        try:
            image: Tensor = self(self.rasterize(camera), camera)
        finally:
            self.train(training)
        return image.clamp(0, 1).cpu()
