"""Fewer channels for a trained network: those go that the ones beside them make up for best.

Which these are, and how the weights that stay then change, has a closed form: Hassibi and Stork, "Second
Order Derivatives for Network Pruning: Optimal Brain Surgeon" (NeurIPS 1992), here of each convolution's
squared error on what it reads, and by blocks, a channel's nine weights at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.model.fusion import Fusion
from nmbg.model.photographs import Gathered

# Pixels of a view whose surroundings are read: a few for each of the 289 weights that make up for the others.
PIXELS = 3000
# Share of a channel's power by which weights are held back where channels say the same.
DAMPING = 1e-6
TAPS = 9  # of a 3×3 convolution


class Weights(NamedTuple):
    """Of a convolution, float64.

    Args:
        kernel: [outputs, inputs, 3, 3].
        bias: [outputs].
    """

    kernel: Tensor
    bias: Tensor


class Narrowing:
    """What a network and the views that it shows say about its channels.

    Args:
        network: that was trained; it stays as it is.
        sights: what it reads of some views.
    """

    @torch.no_grad()
    def __init__(self, network: Fusion, sights: Sequence[Gathered]) -> None:
        self.network = network
        parameters = [parameter.double().cpu() for parameter in network.parameters()]
        self._weights = [Weights(*pair) for pair in zip(parameters[::2], parameters[1::2], strict=True)]
        self._moments = [torch.zeros(()).double() for _ in self._weights[1:]]
        generator = torch.Generator().manual_seed(0)
        for sight in sights:
            sight = sight.to(next(network.parameters()).device)
            for i, read in enumerate(network.hidden(sight.features()[None])):
                patches = _patches(read[0], generator)
                self._moments[i] = self._moments[i] + patches.T @ patches / (len(sights) * PIXELS)
        self._importance = torch.stack([_importance(sight) for sight in sights]).mean(0).sqrt()

    @torch.no_grad()
    def to(self, widths: Sequence[int]) -> Fusion:
        """The network with so many channels in its hidden layers, of which it may have no fewer."""
        layers, importance = list(self._weights), self._importance
        # From the last one on: which channels are dear hangs on who reads them.
        for i in reversed(range(len(widths))):
            kept, layers[i + 1] = without_inputs(layers[i + 1], self._moments[i], widths[i], importance)
            layers[i] = Weights(layers[i].kernel[kept], layers[i].bias[kept])
            importance = layers[i + 1].kernel.square().sum((0, 2, 3)).sqrt()
        narrow = Fusion(self.network.sources, widths)
        for parameter, value in zip(narrow.parameters(), chain(*layers), strict=True):
            parameter.copy_(value)
        narrow.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return narrow.to(next(self.network.parameters()).device)


def without_inputs(
    layer: Weights, moments: Tensor, count: int, importance: Tensor
) -> tuple[list[int], Weights]:
    """Let a convolution read `count` of its channels; the weights of these give most of what it gave.

    One channel after another goes: that without which the others' best weights err least.

    Args:
        layer: the convolution.
        moments: [9 · inputs + 1, …] float64, second moments of what it reads, and of a one for its bias.
        count: channels that stay.
        importance: [outputs], of an error in each output.

    Returns:
        the channels that stay, ascending, and the weights for them.
    """
    outputs, inputs = layer.kernel.shape[:2]
    weights = torch.cat([layer.kernel.flatten(1), layer.bias[:, None]], 1)
    damped = moments + DAMPING * moments.diagonal().mean() * torch.eye(len(moments)).to(moments)
    inverse, kept = torch.linalg.inv(damped), list(range(inputs))
    while len(kept) > count:
        blocks = [slice(TAPS * c, TAPS * (c + 1)) for c in kept]
        own = torch.linalg.inv(torch.stack([inverse[b, b] for b in blocks]))
        lost = torch.stack([weights[:, b] for b in blocks]) * importance[:, None]
        i = int(torch.einsum("cok,ckl,col->c", lost, own, lost).argmin())
        block = blocks[i]
        weights = weights - weights[:, block] @ own[i] @ inverse[block]
        inverse = inverse - inverse[:, block] @ own[i] @ inverse[block]
        del kept[i]
    kernel = weights[:, :-1].reshape(outputs, inputs, 3, 3)[:, kept]
    return kept, Weights(kernel, weights[:, -1])


def _patches(image: Tensor, generator: torch.Generator) -> Tensor:
    """Random pixels' surroundings as a convolution reads them, and a one, [PIXELS, 9 · C + 1] float64."""
    _, height, width = image.shape
    padded = F.pad(image, (1, 1, 1, 1)).cpu()
    y, x = (torch.randint(side, (PIXELS,), generator=generator) for side in (height, width))
    taps = [padded[:, y + dy, x + dx] for dy in range(3) for dx in range(3)]
    patches = torch.stack(taps, 1).flatten(0, 1).T.double()
    return torch.cat([patches, torch.ones(PIXELS, 1).double()], 1)


def _importance(sight: Gathered) -> Tensor:
    """Mean square of what the outputs change in a view: colour one to one, a preference by what it shifts."""
    weights, shown = sight.weights.double(), sight.shown.double()
    blend = (weights[:, None] * shown).sum(0)
    shifts = (weights[:, None] * (shown - blend)).square().mean((1, 2, 3))
    return torch.cat([torch.ones(3).double(), shifts.cpu()])
