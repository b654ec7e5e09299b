import pytest
import torch

from nmbg.model.unet import GatedConv, Normalise, UNet

WIDTHS = (16, 32, 64, 128, 256)


def count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize(("layers", "channels", "parameters"), [(2, 16, 6_142_851), (1, 8, 1_928_771)])
def test_parameter_counts_of_the_papers(layers: int, channels: int, parameters: int) -> None:
    assert count(UNet(layers, channels, WIDTHS)) == parameters


def test_every_input_reaches_the_image() -> None:
    torch.manual_seed(0)
    net = UNet(2, 5, (8, 16, 24))
    pyramids = [[torch.randn(1, 5, 16 >> k, 24 >> k, requires_grad=True) for k in range(3)] for _ in range(2)]
    image = net(pyramids)
    assert image.shape == (1, 3, 16, 24)
    image.square().sum().backward()
    for layer in pyramids:
        for level in layer:
            assert level.grad is not None
            assert level.grad.abs().amax() > 0


def test_encoders_alone_normalise() -> None:
    net = UNet(2, 5, (8, 16, 24))
    normalised = [name for name, part in net.named_modules() if isinstance(part, Normalise)]
    assert len(normalised) == 2 * 3
    assert all(name.startswith("encoders") for name in normalised)


@pytest.mark.parametrize("training", [True, False])
def test_a_render_is_normalised_by_its_own_statistics(training: bool) -> None:
    torch.manual_seed(0)
    block, plain, reference = GatedConv(3, 4, norm=True), GatedConv(3, 4), torch.nn.BatchNorm2d(4)
    plain.conv = block.conv
    torch.nn.init.normal_(block.norm.weight)
    torch.nn.init.normal_(block.norm.bias)
    reference.load_state_dict(block.norm.state_dict(), strict=False)
    block.train(training)
    for _ in range(2):
        x = torch.randn(1, 3, 6, 7)
        torch.testing.assert_close(block(x), reference(plain(x)))  # of a batch of one, in training


def test_gated_block_is_elu_times_sigmoid() -> None:
    torch.manual_seed(0)
    block = GatedConv(3, 4)
    x = torch.randn(1, 3, 6, 7)
    value = torch.nn.functional.conv2d(x, block.conv.weight[:4], block.conv.bias[:4], padding=1)
    gate = torch.nn.functional.conv2d(x, block.conv.weight[4:], block.conv.bias[4:], padding=1)
    expected = torch.nn.functional.elu(value) * torch.sigmoid(gate)
    torch.testing.assert_close(block(x), expected)
