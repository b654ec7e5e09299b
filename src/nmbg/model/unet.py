"""The multi-scale gated U-Net of NPBG with one encoder per layer (paper, section 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nmbg.ops import gate


class Normalise(nn.BatchNorm2d):
    """The paper's BatchNorm, without running statistics: of a batch of one image, that image's own.

    So a render is normalised as the network has learnt.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, track_running_stats=False)

    def forward(self, x: Tensor) -> Tensor:  # [1, channels, H, W] -> the same
        """Normalise; torch's module refuses a coarsest level of one pixel."""
        # GroupNorm says the same; its gradients in channels_last took 5 to 37 times as long on a CPU.
        return torch.batch_norm(x, self.weight, self.bias, None, None, True, 0.0, self.eps, True)


class GatedConv(nn.Module):
    """ELU(conv x) ⊙ sigmoid(conv′ x), both 3×3, computed as one convolution; then normalised, or not."""

    def __init__(self, inputs: int, outputs: int, norm: bool = False) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, 2 * outputs, 3, padding=1)
        self.norm = Normalise(outputs) if norm else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:  # [B, inputs, H, W] -> [B, outputs, H, W]
        """Filter a feature image."""
        out: Tensor = self.norm(gate(self.conv(x)))
        return out


class Encoder(nn.Module):
    """One layer's feature images, finest first → the encoded images of all levels."""

    def __init__(self, channels: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.start = GatedConv(channels, widths[0], norm=True)
        self.down = nn.ModuleList(
            GatedConv(above, below - channels, norm=True) for above, below in pairwise(widths)
        )

    def forward(self, levels: list[Tensor]) -> list[Tensor]:  # [B, channels, H/2ᵏ, W/2ᵏ] each
        """Encode a pyramid."""
        encoded = [self.start(levels[0])]
        for down, features in zip(self.down, levels[1:], strict=True):
            encoded.append(torch.cat([down(F.avg_pool2d(encoded[-1], 2)), features], dim=1))
        return encoded


class Up(nn.Module):
    """Bilinear ×2, a 3×3 convolution, the encoders' skips, a gated convolution."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.merge = GatedConv(2 * outputs, outputs)

    def forward(self, x: Tensor, skips: Tensor) -> Tensor:
        """Go one level up."""
        x = self.conv(F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False))
        out: Tensor = self.merge(torch.cat([x, skips], dim=1))
        return out


class UNet(nn.Module):
    """Feature pyramids of one or two layers → an image; normalised in the encoders, not in the decoder.

    With two layers, 16 channels and the paper's widths it has 6,142,851 parameters; with one layer and
    8 channels it is NPBG's network, 1,928,771 parameters.

    Args:
        layers: number of encoders; their weights are not shared.
        channels: channels of a layer's feature image.
        widths: encoded channels per level, finest first; each but the first exceeds `channels`.
    """

    def __init__(self, layers: int, channels: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.encoders = nn.ModuleList(Encoder(channels, widths) for _ in range(layers))
        outputs = [layers * width for width in widths]
        self.decoder = nn.ModuleList(
            Up(below, above) for above, below in zip(outputs[-2::-1], outputs[:0:-1], strict=True)
        )
        self.out = nn.Conv2d(outputs[0], 3, 1)

    def forward(self, pyramids: list[list[Tensor]]) -> Tensor:
        """Render.

        Args:
            pyramids: per layer, per level k, [B, channels, H/2ᵏ, W/2ᵏ]; 2^(levels − 1) divides H and W.

        Returns:
            [B, 3, H, W], linear.
        """
        encoded = [encoder(levels) for encoder, levels in zip(self.encoders, pyramids, strict=True)]
        skips = [torch.cat(level, dim=1) for level in zip(*encoded, strict=True)]
        x = skips.pop()
        for up in self.decoder:
            x = up(x, skips.pop())
        image: Tensor = self.out(x)
        return image
