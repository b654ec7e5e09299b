"""Image metrics, each with the settings that its number depends on (docs/evaluation.md).

All take an estimate and a target [3, H, W] in [0, 1] and return a float.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from scipy.ndimage import gaussian_filter
from torch import Tensor, nn

from nmbg.backbones import find_heads, load_features, read_checkpoint
from nmbg.errors import NmbgError


@dataclass(frozen=True)
class Metric:
    """A metric ready for use.

    Args:
        name: as in metrics.json; LPIPS carries its network.
        settings: what the number depends on, in words.
        smallest: least width and height of an image, pixels.
        compute: estimate and target [3, H, W] in [0, 1] → value.
    """

    name: str
    settings: str
    smallest: int
    compute: Callable[[Tensor, Tensor], float]


def psnr(estimate: Tensor, target: Tensor) -> float:
    """−10 log₁₀ of the mean squared error over all pixels and channels, dB; infinite for identical images."""
    _check(estimate, target)
    error = F.mse_loss(estimate.double(), target.double()).item()
    return math.inf if error == 0 else -10 * math.log10(error)


def ssim(estimate: Tensor, target: Tensor) -> float:
    """SSIM as torchmetrics and gsplat report it: Gaussian window, data range 1.

    11×11 window, σ 1.5, K₁ .01, K₂ .03; the border is reflected, so that every pixel counts.
    """
    _check(estimate, target)

    def local_mean(images: Tensor) -> Tensor:
        # In float64 eight times as fast as torch's convolution on a CPU.
        smooth = gaussian_filter(images.cpu().numpy(), 1.5, radius=5, mode="mirror", axes=(2, 3))
        return torch.from_numpy(smooth).flatten(0, 1)

    return _mean_similarity(estimate, target, local_mean, data_range=1.0, unbiased=1.0)


def ssim_svs(estimate: Tensor, target: Tensor) -> float:
    """SSIM as FVS, SVS and NMBG reported it: old scikit-image on float input, whose data range was 2.

    7×7 uniform window, sample covariance, K₁ .01, K₂ .03; windows inside the image only: 3 px are dropped.
    """
    _check(estimate, target)

    def local_mean(images: Tensor) -> Tensor:
        return F.avg_pool2d(images, 7, stride=1).flatten(0, 1)

    return _mean_similarity(estimate, target, local_mean, data_range=2.0, unbiased=49 / 48)


def _mean_similarity(
    estimate: Tensor,
    target: Tensor,
    local_mean: Callable[[Tensor], Tensor],  # [5, C, H, W] → [5 C, …]
    data_range: float,
    unbiased: float,
) -> float:
    """Mean of the structural similarity map (Wang et al. 2004, equation 13), in float64."""
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    x, y = estimate.double(), target.double()
    mx, my, mxx, myy, mxy = local_mean(torch.stack([x, y, x * x, y * y, x * y])).chunk(5)
    # In this order identical images are rounded alike above and below, and have exactly 1.
    variances = unbiased * ((mxx - mx * mx) + (myy - my * my))
    covariance = unbiased * (mxy - mx * my)
    similarity = (2 * mx * my + c1) * (2 * covariance + c2) / ((mx * mx + my * my + c1) * (variances + c2))
    return float(similarity.mean())


LPIPS_LAYERS = {
    "alex": ("alexnet", ("relu1", "relu2", "relu3", "relu4", "relu5")),
    "vgg": ("vgg16", ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")),
    "squeeze": ("squeezenet1_1", ("relu1", "fire3", "fire5", "fire6", "fire7", "fire8", "fire9")),
}


class LPIPS(nn.Module):
    """Learned perceptual image patch similarity, version 0.1 (Zhang et al. 2018).

    Features are scaled to unit length per pixel; their squared differences are weighted per channel by the
    linear heads and averaged over the pixels; layers are summed. The original scales images to [−1, 1], takes
    out (−.030, −.088, −.188) and divides by (.458, .448, .450): on [0, 1] that is ImageNet's mean and
    deviation, which the backbone applies.

    Args:
        net: "alex" (the paper's tables), "vgg" or "squeeze".
        folder: where the user keeps weights.

    Raises:
        NmbgError: the network's weights or the heads are missing, damaged or incomplete.
    """

    def __init__(self, net: str, folder: Path | None = None) -> None:
        super().__init__()
        backbone, layers = LPIPS_LAYERS[net]
        self.heads = _load_heads(net, len(layers), folder)
        self.backbone = load_features(backbone, layers, folder)

    @torch.no_grad()
    def forward(self, estimate: Tensor, target: Tensor) -> Tensor:
        """Distances of images [B, 3, H, W] in [0, 1], [B] float32."""
        total = torch.zeros(len(estimate), device=estimate.device)
        for head, a, b in zip(self.heads, self.backbone(estimate), self.backbone(target), strict=True):
            difference = (_unit_length(a) - _unit_length(b)) ** 2
            total += F.conv2d(difference, head).mean(dim=(1, 2, 3))
        return total


def _unit_length(features: Tensor) -> Tensor:
    length: Tensor = torch.linalg.vector_norm(features, dim=1, keepdim=True)
    return features / (length + 1e-10)


def _load_heads(net: str, count: int, folder: Path | None) -> nn.ParameterList:
    path = find_heads(net, folder)
    checkpoint = read_checkpoint(path)
    heads = [checkpoint.get(f"lin{i}.model.1.weight") for i in range(count)]
    if any(head is None or head.ndim != 4 for head in heads):
        raise NmbgError(f"{path}: not the LPIPS v0.1 heads of {net}; get the file anew")
    return nn.ParameterList(
        [nn.Parameter(head.float(), requires_grad=False) for head in heads if head is not None]
    )


def make_metrics(
    names: Sequence[str],
    lpips_net: str = "alex",
    weights: Path | None = None,
    device: torch.device | None = None,
) -> list[Metric]:
    """The metrics `names`, in this order, each once; LPIPS loads its network here.

    Args:
        names: of `nmbg.evaluation.METRICS`.
        lpips_net: network of LPIPS: "alex", "vgg" or "squeeze".
        weights: where the user keeps pretrained weights.
        device: where LPIPS runs.

    Raises:
        NmbgError: LPIPS is asked for and its weights are not to be had.
    """
    return [_make(name, lpips_net, weights, device) for name in dict.fromkeys(names)]


def _make(name: str, lpips_net: str, weights: Path | None, device: torch.device | None) -> Metric:
    if name == "psnr":
        return Metric(name, "images in [0, 1], all pixels and channels, dB", 1, psnr)
    if name == "ssim":
        return Metric(name, "11x11 Gaussian window, sigma 1.5, data range 1, reflected border", 11, ssim)
    if name == "ssim_svs":
        return Metric(
            name,
            "7x7 uniform window, sample covariance, 3-px border dropped, data range 2 (as FVS, SVS, NMBG)",
            7,
            ssim_svs,
        )
    if name == "lpips":
        model = LPIPS(lpips_net, weights).to(device)
        backbone = LPIPS_LAYERS[lpips_net][0]
        return Metric(
            f"lpips_{lpips_net}",
            f"LPIPS v0.1, {backbone}, images scaled to [-1, 1]",
            32,
            lambda a, b: model(a[None].float().to(device), b[None].float().to(device)).item(),
        )
    raise ValueError(f"unknown metric {name}")


def _check(estimate: Tensor, target: Tensor) -> None:
    if estimate.shape != target.shape or estimate.ndim != 3:
        raise ValueError(
            f"expected two images [3, H, W], got {list(estimate.shape)} and {list(target.shape)}"
        )
