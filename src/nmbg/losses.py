"""What training compares: colours (L1) and the features of a pretrained network (L_rec of the paper)."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nmbg.backbones import load_features
from nmbg.errors import NmbgError

PAPER_LAYERS = ("relu1_2", "relu2_2", "relu3_2", "relu4_2", "relu5_2")
PAPER_WEIGHTS = (1.0, 0.75, 0.5, 0.5, 1.0)
# Mean of relu1_2 of a grey chequerboard under the weights that the paper's loss uses, Oxford's.
PAPER_FEATURE = 152.7


def l1(
    image: Tensor,  # [..., C, H, W]
    target: Tensor,  # [..., C, H, W]
    mask: Tensor | None = None,  # [..., 1, H, W]
) -> Tensor:
    """Mean absolute difference, a float32 scalar.

    Args:
        image: [..., C, H, W], any floating dtype.
        target: like `image`.
        mask: [..., 1, H, W] bool or weights in [0, 1]: the mean is over what it holds. An empty mask gives 0.
    """
    if image.shape != target.shape:
        raise ValueError(f"expected images of one shape, got {list(image.shape)} and {list(target.shape)}")
    difference = (image - target).abs()
    # Summed in float32: under autocast the features are bfloat16, whose sums would keep three digits.
    if mask is None:
        return difference.mean(dtype=torch.float32)
    weight = mask.to(difference.dtype).expand_as(difference)
    total = (difference * weight).sum(dtype=torch.float32)
    return total / weight.sum(dtype=torch.float32).clamp_min(torch.finfo(torch.float32).tiny)


def parse_perceptual(spec: str) -> tuple[str, ...]:
    """Layers of a `--perceptual` specification: "vgg19" or "vgg19:relu1_2,relu2_2,…", at most five.

    Raises:
        NmbgError: it is neither.
    """
    net, colon, listed = spec.partition(":")
    layers = tuple(name.strip() for name in listed.split(",")) if colon else PAPER_LAYERS
    if net != "vgg19" or len(layers) > len(PAPER_WEIGHTS) or not all(layers):
        raise NmbgError(
            f"--perceptual {spec}: expected none, vgg19, or vgg19:LAYER,… with at most "
            f"{len(PAPER_WEIGHTS)} layers, such as vgg19:relu1_2,relu2_2,relu3_1"
        )
    return layers


class Perceptual(nn.Module):
    """L_rec of the paper: Σ w_l · mean |Φ_l(image) − Φ_l(target)| over layers of VGG-19.

    Blocks are pooled by averages, as in the paper's own loss: the gradient then reaches every pixel of a
    window instead of the largest one alone. Inputs are normalised by ImageNet's mean and deviation, for which
    torchvision's weights are made; the paper's were scaled by 255, and its loss is larger by that order.

    Args:
        spec: "vgg19" (the paper's five layers), or "vgg19:relu1_2,relu2_2,relu3_1": these, with the paper's
            weights in order.
        folder: where the user keeps weights.

    Raises:
        NmbgError: the specification is malformed, or weights are missing or incomplete.
    """

    def __init__(self, spec: str, folder: Path | None = None) -> None:
        super().__init__()
        self.layers = layers = parse_perceptual(spec)
        self.weights = PAPER_WEIGHTS[: len(layers)]
        self.network = load_features("vgg19", layers, folder, pooling="average")
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def features(self, image: Tensor) -> list[Tensor]:
        """Features of images [B, 3, H, W] in [0, 1]; per layer, [B, C, h, w]."""
        features: list[Tensor] = self.network(image.contiguous(memory_format=torch.channels_last))
        return features

    @functools.cached_property
    def scale(self) -> float:
        """How large features are beside the paper's, by relu1_2; 1 where that is not the first layer.

        L_GAN is weighted by it, so that λ means what it does in the paper: weights that were trained
        otherwise give features, and an L_rec, of another size.
        """
        if self.layers[0] != PAPER_LAYERS[0]:
            return 1.0
        square = torch.arange(64) // 8
        board = ((square[:, None] + square) % 2 * 0.5 + 0.25).expand(1, 3, 64, 64)
        with torch.no_grad():
            device = next(self.network.parameters()).device
            feature = self.features(board.to(device, torch.float32))[0]
        return float(feature.abs().mean()) / PAPER_FEATURE

    def distance(
        self, features: Sequence[Tensor], target: Sequence[Tensor], mask: Tensor | None = None
    ) -> Tensor:
        """The loss between two lists of features, a float32 scalar.

        Args:
            features: per layer, [B, C, h, w].
            target: like `features`; may have been computed before.
            mask: [B, 1, H, W] of the images; averaged down to each layer, whose mean it weights. Features
                near its border also see pixels beyond it: mask both images first where those differ.
        """
        loss = torch.zeros((), device=features[0].device)
        for weight, a, b in zip(self.weights, features, target, strict=True):
            small = None if mask is None else F.adaptive_avg_pool2d(mask.float(), (a.shape[-2], a.shape[-1]))
            loss = loss + weight * l1(a, b, small)
        return loss

    def forward(self, image: Tensor, target: Tensor, mask: Tensor | None = None) -> Tensor:
        """The loss between two images [B, 3, H, W] in [0, 1]; gradients reach `image` alone."""
        with torch.no_grad():
            target_features = self.features(target)
        return self.distance(self.features(image), target_features, mask)
