"""Pretrained feature networks and where their weights come from.

VGG-16, VGG-19, AlexNet and SqueezeNet 1.1 with torchvision's parameter names, so that torchvision's own
checkpoints load; torchvision itself is not needed. A network is never used with random weights.
"""

from __future__ import annotations

import importlib.util
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn

from nmbg.errors import NmbgError

MEAN, STD = (
    (0.485, 0.456, 0.406),
    (0.229, 0.224, 0.225),
)  # ImageNet's: these networks know no other input
URL = "https://download.pytorch.org/models/"

Pooling = Literal["max", "average"]
Pool = Callable[..., nn.Module]
POOLS: dict[Pooling, Pool] = {"max": nn.MaxPool2d, "average": nn.AvgPool2d}


class Stack:
    """Modules in torchvision's order, and the names of those whose output is a feature."""

    def __init__(self) -> None:
        self.modules: list[nn.Module] = []
        self.layers: dict[str, int] = {}  # name → number of modules up to and with it, ascending

    def add(self, *modules: nn.Module, name: str | None = None) -> None:
        """Append modules; `name` is the feature after the last of them."""
        self.modules += modules
        if name is not None:
            self.layers[name] = len(self.modules)


def _vgg(convolutions: Sequence[int], pool: Pool) -> Stack:
    """Blocks of 3×3 convolutions (Simonyan & Zisserman 2014); relu2_1 is the first of the second block."""
    stack = Stack()
    channels = 3
    for block, (count, width) in enumerate(zip(convolutions, (64, 128, 256, 512, 512), strict=True), start=1):
        for i in range(1, count + 1):
            stack.add(nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(), name=f"relu{block}_{i}")
            channels = width
        stack.add(pool(2, 2))
    return stack


def _alexnet(pool: Pool) -> Stack:
    """AlexNet on one device (Krizhevsky 2014); relu1 to relu5."""
    stack = Stack()
    stack.add(nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(), name="relu1")
    stack.add(pool(3, 2), nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(), name="relu2")
    stack.add(pool(3, 2), nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(), name="relu3")
    stack.add(nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(), name="relu4")
    stack.add(nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(), name="relu5")
    return stack


class Fire(nn.Module):
    """SqueezeNet's module: 1×1 to few channels, then 1×1 beside 3×3 of `width` channels each."""

    def __init__(self, channels: int, squeezed: int, width: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(channels, squeezed, 1)
        self.expand1x1 = nn.Conv2d(squeezed, width, 1)
        self.expand3x3 = nn.Conv2d(squeezed, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """[B, channels, H, W] → [B, 2 width, H, W]."""
        x = self.squeeze(x).relu()
        return torch.cat([self.expand1x1(x), self.expand3x3(x)], dim=1).relu()


def _squeezenet1_1(pool: Pool) -> Stack:
    """SqueezeNet 1.1 (Iandola et al. 2016); relu1 and fire2 to fire9."""
    stack = Stack()
    stack.add(nn.Conv2d(3, 64, 3, stride=2), nn.ReLU(), name="relu1")
    channels = 64
    for number, width in enumerate((64, 64, 128, 128, 192, 192, 256, 256), start=2):
        if number in (2, 4, 6):
            stack.add(pool(3, 2, ceil_mode=True))
        stack.add(Fire(channels, width // 4, width), name=f"fire{number}")
        channels = 2 * width
    return stack


@dataclass(frozen=True)
class Net:
    """A network and its checkpoint.

    Args:
        build: kind of pooling → modules.
        file: torchvision's checkpoint; the eight digits begin its SHA-256.
        otherwise: what a user can do without it.
    """

    build: Callable[[Pool], Stack]
    file: str
    otherwise: str


_NO_LOSS = "train with --perceptual none"
_NO_METRIC = "leave lpips out of --metrics"

NETS = {
    "vgg19": Net(lambda pool: _vgg((2, 2, 4, 4, 4), pool), "vgg19-dcbb9e9d.pth", _NO_LOSS),
    "vgg16": Net(lambda pool: _vgg((2, 2, 3, 3, 3), pool), "vgg16-397923af.pth", _NO_METRIC),
    "alexnet": Net(_alexnet, "alexnet-owt-7be5be79.pth", _NO_METRIC),
    "squeezenet1_1": Net(_squeezenet1_1, "squeezenet1_1-b8a52dc0.pth", _NO_METRIC),
}


class Features(nn.Module):
    """The first modules of a network, frozen: images in, features out.

    Args:
        stack: the network.
        layers: the features, in the order in which they are returned.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, stack: Stack, layers: Sequence[str]) -> None:
        super().__init__()
        self.taps = [stack.layers[name] for name in layers]
        self.features = nn.Sequential(*stack.modules[: max(self.taps)])
        self.register_buffer("mean", torch.tensor(MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).view(1, 3, 1, 1), persistent=False)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features of images.

        Args:
            image: [B, 3, H, W], RGB in [0, 1]; ImageNet's mean and deviation are taken out here.

        Returns:
            per layer, [B, C, h, w].
        """
        if image.ndim != 4 or image.shape[1] != 3:
            raise ValueError(f"expected an image [B, 3, H, W], got {list(image.shape)}")
        x = (image - self.mean) / self.std
        features: dict[int, Tensor] = {}
        for count, module in enumerate(self.features, start=1):
            x = module(x)
            if count in self.taps:
                features[count] = x
        return [features[tap] for tap in self.taps]


def load_features(
    net: str, layers: Sequence[str], folder: Path | None = None, pooling: Pooling = "max"
) -> Features:
    """A pretrained network up to the deepest of `layers`, frozen.

    Args:
        net: "vgg19", "vgg16", "alexnet" or "squeezenet1_1".
        layers: of VGG "relu1_2", "relu2_2", …; of AlexNet "relu1" … "relu5"; of SqueezeNet "relu1", "fire2" …
            "fire9".
        folder: where the user keeps weights; torch's hub cache and a download come after it.
        pooling: between the blocks; the networks were trained with "max".

    Raises:
        NmbgError: a layer is unknown, or the checkpoint is missing, damaged, or lacks a tensor.
    """
    # Built without storage: what the checkpoint does not fill can never be used.
    with torch.device("meta"):
        stack = NETS[net].build(POOLS[pooling])
    unknown = [name for name in layers if name not in stack.layers]
    if unknown or not layers:
        wrong = ", ".join(unknown) or "(none given)"
        raise NmbgError(f"{net} has no layer {wrong}; choose from {', '.join(stack.layers)}")
    features = Features(stack, layers)
    path = find_weights(net, folder)
    checkpoint = read_checkpoint(path)
    chosen = {}
    for key, parameter in features.state_dict().items():
        tensor = checkpoint.get(key)
        if tensor is None or tensor.shape != parameter.shape:
            wrong = f"holds no {key}" if tensor is None else f"holds {key} of shape {list(tensor.shape)}"
            raise NmbgError(f"{path}: {wrong}, {_remedy(net, stack, int(key.split('.')[1]))}")
        chosen[key] = tensor.float()
    features.load_state_dict(chosen, assign=True)
    return features.eval().requires_grad_(False)


def _remedy(net: str, stack: Stack, module: int) -> str:
    """Name the layer that the missing module belongs to, and what to do."""
    complete = [name for name, count in stack.layers.items() if count <= module]
    layer = list(stack.layers)[len(complete)]
    up_to = f"use layers up to {complete[-1]}, " if complete and net == "vgg19" else ""
    file = NETS[net].file
    return f"which {layer} of {net} needs; get {URL}{file} (--weights DIR), {up_to}or {NETS[net].otherwise}"


def installed_weights(net: str, folder: Path | None = None) -> Path | None:
    """The checkpoint of `net` in `folder` or in torch's hub cache; None where neither has it.

    A folder may hold it under torchvision's name or as NET*.pth, also with the first layers only.

    Raises:
        NmbgError: there is no such folder.
    """
    file = NETS[net].file
    if folder is not None:
        if not folder.is_dir():
            raise NmbgError(f"{folder}: no such folder; --weights takes the folder that holds {file}")
        if (folder / file).is_file():
            return folder / file
        # vgg19_bn is another network.
        others = [path for path in folder.glob(f"{net}*.pth") if not path.name.startswith(f"{net}_bn")]
        if others:
            return max(sorted(others), key=lambda path: path.stat().st_size)
    cached = hub_cache() / file
    return cached if cached.is_file() else None


def find_weights(net: str, folder: Path | None = None) -> Path:
    """The checkpoint of `net`: in `folder`, in torch's hub cache, or downloaded into it.

    Raises:
        NmbgError: none of the three has it.
    """
    path = installed_weights(net, folder)
    if path is not None:
        return path
    file, cache = NETS[net].file, hub_cache()
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with _connection_timeout(20):
            torch.hub.download_url_to_file(
                URL + file, str(cache / file), hash_prefix=Path(file).stem.split("-")[-1]
            )
    except (OSError, RuntimeError) as error:  # no connection, no space; a wrong hash
        places = f"neither in {folder} nor in {cache}" if folder else f"not in {cache}"
        raise NmbgError(
            f"{file}: {places}, and the download failed ({_first_line(error)}); "
            f"get {URL}{file} and pass its folder with --weights, or {NETS[net].otherwise}"
        ) from error
    return cache / file


def hub_cache() -> Path:
    """Where torch keeps downloaded checkpoints."""
    return Path(torch.hub.get_dir()) / "checkpoints"


@contextmanager
def _connection_timeout(seconds: float) -> Iterator[None]:
    """Without it, a firewall that swallows packets would hang the download for ever."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(seconds)
    try:
        yield
    finally:
        socket.setdefaulttimeout(before)


def find_heads(net: str, folder: Path | None = None) -> Path:
    """The linear heads of LPIPS v0.1: lpips/NET.pth in `folder`, else those that torchmetrics brings.

    Args:
        net: "alex", "vgg" or "squeeze".
        folder: where the user keeps weights.

    Raises:
        NmbgError: neither place has them.
    """
    places = [] if folder is None else [folder / "lpips" / f"{net}.pth"]
    torchmetrics = importlib.util.find_spec("torchmetrics")
    if torchmetrics is not None and torchmetrics.origin is not None:
        places.append(Path(torchmetrics.origin).parent / f"functional/image/lpips_models/{net}.pth")
    for place in places:
        if place.is_file():
            return place
    raise NmbgError(
        f"lpips/{net}.pth: not found; get https://github.com/richzhang/PerceptualSimilarity/raw/master/lpips/weights/"
        f"v0.1/{net}.pth into lpips/ of the folder given by --weights, or {_NO_METRIC}"
    )


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """Read a state dict; no code in it is run.

    Raises:
        NmbgError: the file cannot be read or is something else.
    """
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # a damaged pickle or archive raises whatever it likes
        raise NmbgError(
            f"{path}: not a readable checkpoint ({type(error).__name__}); get the file anew"
        ) from error
    if not isinstance(content, dict) or not all(isinstance(value, Tensor) for value in content.values()):
        raise NmbgError(f"{path}: not a state dict of tensors; get the file anew")
    return content


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0] or type(error).__name__
