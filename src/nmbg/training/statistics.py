"""BatchNorm's statistics: of whole views, and held while the rest of the network learns to live with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from torch import Tensor, nn
from torch.optim.swa_utils import update_bn

VIEWS = 20  # of each scene, spread evenly


def renew_statistics(network: nn.Module, shows: Iterable[Callable[[], Tensor]]) -> None:
    """Replace running statistics by means over views.

    A window's statistics are not a frame's, and those of earlier steps are another network's.

    Args:
        network: whose BatchNorm layers are renewed; without any, nothing is shown.
        shows: each renders a view through the network.
    """
    update_bn(shows, _Showing(network))


def hold_statistics(network: nn.Module) -> None:
    """Normalise by the running statistics, and leave them as they are, until train() is called again."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eval()


class _Showing(nn.Module):
    """The network, run by whatever shows something through it."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, show: Callable[[], Tensor]) -> Tensor:
        return show()
