"""What the presets share with the paper: docs/method.md names the section of each number."""

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from nmbg.losses import PAPER_LAYERS, PAPER_WEIGHTS
from nmbg.model.unet import UNet
from nmbg.training import artificial
from nmbg.training.adversary import RATE
from nmbg.training.config import NETWORK, PRESETS
from nmbg.training.full import EPOCHS

PAPER, NPBG = PRESETS["paper"], PRESETS["npbg"]


def test_memory_on_the_mesh() -> None:
    assert (PAPER.model.features, PAPER.model.bases) == (8, 9)
    assert PAPER.model.faces
    assert PAPER.model.points
    assert PAPER.model.layers == 2
    assert PAPER.start == "zeros"
    assert PAPER.model.radius_px(1920, 1080) == pytest.approx(3.24)
    assert PAPER.model.radius_px(976, 544) == pytest.approx(1.63, abs=0.005)
    assert PAPER.model.radius_px(1600, 1200) == pytest.approx(3.60)
    assert (NPBG.model.features, NPBG.model.bases, NPBG.model.layers) == (8, 1, 1)
    assert not NPBG.model.faces
    assert not NPBG.model.point_weight
    assert NPBG.model.radius_px(1920, 1080) == 0.5


def test_network() -> None:
    assert PAPER.model.widths == NPBG.model.widths == NETWORK == (16, 32, 64, 128, 256)
    assert (PAPER.model.channels, NPBG.model.channels) == (16, 8)


@pytest.mark.parametrize(("layers", "channels", "gmac"), [(2, 16, 130), (1, 8, 34.9)])
def test_multiply_adds_at_976_by_544(layers: int, channels: int, gmac: float) -> None:
    with torch.device("meta"):
        network = UNet(layers, channels, NETWORK)
        pyramid = [torch.empty(1, channels, 544 >> k, 976 >> k) for k in range(5)]
    with FlopCounterMode(display=False) as counter:
        network([pyramid] * layers)
    assert counter.get_total_flops() / 2e9 == pytest.approx(gmac, rel=0.002)


def test_receptive_field() -> None:
    """Of one pixel, in pixels of each level; it does not depend on the widths."""
    network = UNet(1, 1, (2, 3, 4, 5, 6)).double()
    for encoder in network.encoders:  # what normalises sees the whole image
        for block in (encoder.start, *encoder.down):
            block.norm = torch.nn.Identity()
    for parameter in network.parameters():
        torch.nn.init.constant_(parameter, 0.01)  # all paths add up, none cancels another
    pyramid = [
        torch.zeros(1, 1, 256 >> k, 256 >> k, dtype=torch.float64, requires_grad=True) for k in range(5)
    ]
    network([pyramid])[0, 0, 128, 128].backward()
    sides = []
    for level in pyramid:
        assert level.grad is not None
        reached = (level.grad[0, 0] != 0).nonzero()
        sides.append((reached.amax(0) - reached.amin(0) + 1).tolist())
    assert sides == [[158, 158], [76, 76], [36, 36], [16, 16], [6, 6]]


def test_losses() -> None:
    (stage,) = PAPER.stages
    assert PAPER.perceptual == "vgg19"
    assert PAPER_LAYERS == ("relu1_2", "relu2_2", "relu3_2", "relu4_2", "relu5_2")
    assert PAPER_WEIGHTS == (1.0, 0.75, 0.5, 0.5, 1.0)
    assert (stage.perceptual, stage.l1) == (1.0, 0.0)
    assert stage.adversarial == 1.0  # times Perceptual.scale: tests/test_losses.py


def test_schedule() -> None:
    (stage,) = PAPER.stages
    assert (stage.descriptor_rate, stage.network_rate, RATE) == (0.1, 1e-4, 1e-4)
    assert (PAPER.zoom, PAPER.window) == ((0.5, 1.0), 0.5)
    assert PAPER.epochs == 100
    assert EPOCHS == 15


def test_artificial_views() -> None:
    assert artificial.SHELL == (0.6, 1.0)
    assert artificial.DEVIATIONS == 1.5
