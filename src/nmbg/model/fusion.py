"""The network over the photographs: it prefers some of them, pixel by pixel, and adds to what they show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from torch import Tensor, nn

from nmbg.model.photographs import count_features


class Fusion(nn.Module):
    """What mesh and photographs show of a view → a preference for each photograph, and colour to add.

    A few 3×3 convolutions at full resolution with ELU between them, which begin as nothing. A gated U-Net in
    their place shows the same where it learns, and on some scenes shuts its gates for good instead
    (docs/quality.md).

    Args:
        sources: K, photographs blended in a pixel.
        widths: channels of the hidden layers.
    """

    def __init__(self, sources: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.sources = sources
        self.layers = nn.Sequential()
        for inputs, outputs in pairwise((count_features(sources), *widths)):
            self.layers.extend((nn.Conv2d(inputs, outputs, 3, padding=1), nn.ELU()))
        last = nn.Conv2d(widths[-1], 3 + sources, 3, padding=1)
        for parameter in last.parameters():
            nn.init.zeros_(parameter)
        self.layers.append(last)

    def hidden(self, features: Tensor) -> Iterator[Tensor]:
        """What each hidden layer gives the next one, [1, width, H, W]."""
        for layer in list(self.layers)[:-1]:
            features = layer(features)
            if isinstance(layer, nn.ELU):
                yield features

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Look at a view.

        Args:
            features: [1, F, H, W], `Gathered.features()`.

        Returns:
            colour to add, [3, H, W], and logarithms of factors on the photographs' weights, [K, H, W].
        """
        added, preference = self.layers(features)[0].float().split([3, self.sources])
        # Bounded: a weight of zero stays zero, and no source is ever lost for good.
        return added, 4 * (preference / 4).tanh()
