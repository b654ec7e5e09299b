"""The discriminator of the adversarial loss: photographs from renders (paper, section 3.4)."""

from __future__ import annotations

import math
from itertools import pairwise

import torch.nn.functional as F
from torch import Tensor, nn

# Sizes of what is judged; the channels end at WIDEST whatever the size.
SIZES = (256, 512)
WIDEST = 512
SLOPE = 0.2


class Discriminator(nn.Module):
    """Strided 4×4 convolutions down to 4×4 pixels and one logit, as DCGAN's: no bias, no normalisation.

    With images of 256 pixels it has 2,802,432 parameters, with 512 pixels 2,804,096.

    Args:
        size: side of the images, 256 or 512 pixels; log₂(size) − 2 convolutions halve it.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        if size not in SIZES:
            raise ValueError(f"size: expected {SIZES[0]} or {SIZES[1]}, got {size}")
        self.size = size
        halvings = int(math.log2(size)) - 2
        channels = [3, *(WIDEST >> k for k in reversed(range(halvings)))]
        self.halve = nn.ModuleList(
            nn.Conv2d(above, below, 4, stride=2, padding=1, bias=False) for above, below in pairwise(channels)
        )
        self.judge = nn.Conv2d(WIDEST, 1, 4, bias=False)

    def forward(self, image: Tensor) -> Tensor:
        """Logits of being photographs.

        Args:
            image: [B, 3, size, size], colours in [0, 1].

        Returns:
            [B].
        """
        x = 2 * image - 1
        for convolution in self.halve:
            x = F.leaky_relu(convolution(x), SLOPE)
        logits: Tensor = self.judge(x).flatten()
        return logits


def size_for(width: int, height: int) -> int:
    """The size at which images of width × height pixels are judged; the largest that enlarges none."""
    fitting = [size for size in SIZES if size <= min(width, height)]
    return max(fitting, default=SIZES[0])
