"""Channels that are cut from a trained network: which go, and what the others then make up for."""

from collections.abc import Sequence
from copy import deepcopy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from nmbg.capacity.channels import TAPS, Narrowing, Weights, without_inputs
from nmbg.model.fusion import Fusion
from nmbg.model.photographs import Gathered

SOURCES = 3


def sight(seed: int, width: int = 40, height: int = 32) -> Gathered:
    generator = torch.Generator().manual_seed(seed)

    def smooth(*shape: int) -> Tensor:
        coarse = torch.rand(1, *shape, height // 4, width // 4, generator=generator)
        return torch.nn.functional.interpolate(coarse, (height, width), mode="bilinear")[0]

    weights = smooth(SOURCES).softmax(0)
    shown = 0.2 * (smooth(3 * SOURCES) - 0.5).unflatten(0, (SOURCES, 3))
    parts = smooth(3), shown, weights, smooth(1)[0], smooth(1)[0]
    return Gathered(*(part.half() for part in parts))


def network(widths: Sequence[int], seed: int = 0) -> Fusion:
    """As if it were trained: no layer is nothing."""
    torch.manual_seed(seed)
    fusion = Fusion(SOURCES, widths)
    with torch.no_grad():
        for layer in convolutions(fusion):
            layer.weight.normal_(0, 0.1)
            layer.bias.normal_(0, 0.1)
    return fusion


@torch.no_grad()
def change(a: Fusion, b: Fusion, views: Sequence[Gathered]) -> float:
    """Largest difference of what two networks say of views."""
    said = [[torch.cat(net(view.features()[None])) for view in views] for net in (a, b)]
    return max(float((x - y).abs().max()) for x, y in zip(*said, strict=True))


def convolutions(fusion: Fusion) -> list[nn.Conv2d]:
    return [layer for layer in fusion.layers if isinstance(layer, nn.Conv2d)]


VIEWS = [sight(seed) for seed in range(3)]


def test_as_wide_as_before_is_what_was() -> None:
    whole = network((6, 5))
    assert change(whole, Narrowing(whole, VIEWS).to((6, 5)), VIEWS) < 1e-6


@pytest.mark.parametrize("widths", [(6,), (6, 5), (4, 6, 5)])
def test_channels_that_nobody_reads_go_without_a_trace(widths: tuple[int, ...]) -> None:
    whole = network(widths)
    with torch.no_grad():
        for layer in convolutions(whole)[1:]:
            layer.weight[:, [0, 2]] = 0
    narrow = Narrowing(whole, VIEWS).to([width - 2 for width in widths])
    assert change(whole, narrow, VIEWS) < 1e-5
    for before, after in zip(convolutions(whole), convolutions(narrow), strict=True):
        assert before.weight.shape[0] - after.weight.shape[0] in (0, 2)


def test_what_a_channel_says_twice_is_said_once() -> None:
    """Their readers' weights differ: the one that stays must take over both."""
    whole = network((6,))
    first = convolutions(whole)[0]
    with torch.no_grad():
        first.weight[4], first.bias[4] = first.weight[1], first.bias[1]
    assert change(whole, Narrowing(whole, VIEWS).to((5,)), VIEWS) < 2e-3
    merely_dropped = deepcopy(whole)
    with torch.no_grad():
        convolutions(merely_dropped)[1].weight[:, 4] = 0
    assert change(whole, merely_dropped, VIEWS) > 0.02


def test_the_network_that_was_trained_stays_as_it_is() -> None:
    whole = network((6, 5))
    before = deepcopy(whole.state_dict())
    Narrowing(whole, VIEWS).to((2, 2))
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, before[name])


def test_fewer_channels_err_more() -> None:
    whole = network((8, 8))
    narrowing = Narrowing(whole, VIEWS)
    errors = []
    for width in (7, 5, 3, 1):
        narrow = narrowing.to((width, width))
        with torch.no_grad():
            said = [(whole(v.features()[None])[0] - narrow(v.features()[None])[0]) for v in VIEWS]
        errors.append(sum(float(e.square().mean()) for e in said))
    assert errors == sorted(errors)
    assert errors[0] < 0.2 * errors[-1]


@given(seed=st.integers(0, 1000), inputs=st.integers(2, 5), outputs=st.integers(1, 4), data=st.data())
def test_weights_that_stay_are_those_of_least_squares(
    seed: int, inputs: int, outputs: int, data: st.DataObject
) -> None:
    count = data.draw(st.integers(1, inputs - 1))
    generator = torch.Generator().manual_seed(seed)
    n = TAPS * inputs
    mixed = torch.eye(n).double() + 0.1 * torch.randn(n, n, generator=generator).double()
    read = torch.randn(400, n, generator=generator).double() @ mixed
    read = torch.cat([read, torch.ones(400, 1).double()], 1)
    kernel = torch.randn(outputs, inputs, 3, 3, generator=generator).double()
    bias = torch.randn(outputs, generator=generator).double()
    importance = torch.rand(outputs, generator=generator).double() + 0.1
    moments = read.T @ read / len(read)
    kept, narrow = without_inputs(Weights(kernel, bias), moments, count, importance)
    assert kept == sorted(set(kept))
    assert len(kept) == count

    given_ = read @ torch.cat([kernel.flatten(1), bias[:, None]], 1).T

    def least_squares(channels: Sequence[int]) -> tuple[float, Tensor]:
        columns = [TAPS * c + tap for c in channels for tap in range(TAPS)] + [n]
        solution = torch.linalg.lstsq(read[:, columns], given_).solution
        left = (read[:, columns] @ solution - given_) * importance
        return float(left.square().sum()), solution

    error, solution = least_squares(kept)
    found = torch.cat([narrow.kernel.flatten(1), narrow.bias[:, None]], 1).T
    assert torch.allclose(found, solution, rtol=1e-3, atol=1e-3 * float(solution.abs().max()))
    if count == inputs - 1:  # of single channels, the one that costs least
        others = [[c for c in range(inputs) if c != left] for left in range(inputs)]
        assert error <= 1.001 * min(least_squares(channels)[0] for channels in others)
