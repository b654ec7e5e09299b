"""What a frame of a model costs."""

from __future__ import annotations

import statistics
import time

import torch
from torch.utils.flop_counter import FlopCounterMode

from nmbg.cameras import Camera
from nmbg.model.photographs import CANDIDATES, count_features
from nmbg.model.renderer import Renderer

# Multiply-adds of a photograph in a pixel: warp 9, four depths 4, score 8; of one that is blended: four
# texels of three colours 12, its share 3.
WARP, TEXELS = 21, 15


def multiply_adds(renderer: Renderer, camera: Camera) -> int:
    """Multiply-adds of a frame: counted by torch for the network, and as stated here for all else.

    A sample on a face mixes three corners' coefficients; a pixel looks into as many photographs as are
    chosen for a view at most.
    """
    config = renderer.config
    padded = renderer.padded(camera)
    pixels = padded.width * padded.height
    count = 3 * config.bases * config.features * config.supersample**2 * pixels * config.layers
    if config.sources:
        held = 0 if renderer.photographs is None else len(renderer.photographs.views)
        count += (min(CANDIDATES, held) * WARP + config.sources * TEXELS) * pixels
    return count + network_multiply_adds(renderer, padded)


def network_multiply_adds(renderer: Renderer, padded: Camera) -> int:
    """Multiply-adds of the network on a frame whose sizes are whole at every level."""
    if renderer.network is None:
        return 0
    config = renderer.config
    channels = count_features(config.sources) if config.sources else config.channels
    device = next(renderer.network.parameters()).device
    sizes = [(padded.height >> k, padded.width >> k) for k in range(config.levels)]
    levels = [torch.zeros(1, channels, *size, device=device) for size in sizes]
    counter = FlopCounterMode(display=False)
    with torch.no_grad(), counter:
        renderer.network(levels[0] if config.sources else [levels] * config.layers)
    return counter.get_total_flops() // 2


def seconds_per_frame(renderer: Renderer, camera: Camera, repeats: int = 3) -> float:
    """Median time of a new view, after one to warm up."""
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        renderer.render(camera)
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])
