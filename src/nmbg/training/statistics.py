"""BatchNorm's statistics of a trained network: of whole views as it shows them now, not of its way there."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from torch import Tensor, nn
from torch.optim.swa_utils import update_bn

VIEWS = 20  # of each scene, spread evenly


def renew_statistics(network: nn.Module, shows: Iterable[Callable[[], Tensor]]) -> None:
    """Replace running statistics by means over views.

    A window's statistics are not a frame's, and those of earlier steps are another network's: at the paper's
    constant rate the running ones cost 3.6 dB of held-out PSNR after 1250 steps (docs/method.md).

    Args:
        network: whose BatchNorm layers are renewed; without any, nothing is shown.
        shows: each renders a view through the network.
    """
    update_bn(shows, _Showing(network))


class _Showing(nn.Module):
    """The network, run by whatever shows something through it."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, show: Callable[[], Tensor]) -> Tensor:
        return show()
