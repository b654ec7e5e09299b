from itertools import pairwise

import pytest
import torch

from nmbg.model.fusion import Fusion
from nmbg.model.photographs import Gathered, count_features


@pytest.fixture
def features() -> torch.Tensor:
    return torch.randn(1, count_features(3), 20, 30, generator=torch.Generator().manual_seed(0))


def woken(network: Fusion) -> Fusion:
    """Weights as training might leave them: what begins as nothing says nothing about what it sees."""
    with torch.no_grad():
        torch.nn.init.normal_(network.layers[-1].weight)
    return network


def test_begins_as_nothing(features: torch.Tensor) -> None:
    added, preference = Fusion(3, (8, 8))(features)
    assert added.shape == (3, 20, 30)
    assert preference.shape == (3, 20, 30)
    assert not added.any()
    assert not preference.any()


@pytest.mark.parametrize("widths", [(8,), (8, 6), (4, 4, 4)])
def test_parameters_and_field_of_view_by_hand(features: torch.Tensor, widths: tuple[int, ...]) -> None:
    """A pixel sees one pixel further with every convolution, and no further."""
    network = woken(Fusion(3, widths))
    sizes = (count_features(3), *widths, 6)
    expected = sum(9 * a * b + b for a, b in pairwise(sizes))
    assert sum(p.numel() for p in network.parameters()) == expected
    features.requires_grad_()
    network(features)[0][:, 10, 15].sum().backward()
    rows, columns = features.grad[0].abs().sum(0).nonzero().T
    reach = len(widths) + 1
    assert (rows.min(), rows.max()) == (10 - reach, 10 + reach)
    assert (columns.min(), columns.max()) == (15 - reach, 15 + reach)


def test_preferences_are_bounded(features: torch.Tensor) -> None:
    _, preference = woken(Fusion(3, (8,)))(1e6 * features)
    assert preference.abs().max() <= 4
    assert preference.abs().max() > 3.9


def test_features_hold_what_photographs_and_mesh_show() -> None:
    """In their order, and scaled: residuals of photographs are small."""
    generator = torch.Generator().manual_seed(2)
    sizes = ((3, 4, 5), (2, 3, 4, 5), (2, 4, 5), (4, 5), (4, 5))
    base, shown, weights, trust, score = (torch.rand(size, generator=generator).half() for size in sizes)
    gathered = Gathered(base, shown / 16, weights, trust, score)
    features = gathered.features()
    assert features.shape == (count_features(2), 4, 5)
    assert features.dtype == torch.float32
    torch.testing.assert_close(features[:3] / 4 + 0.5, gathered.blended())
    torch.testing.assert_close(features[3:6] / 4 + 0.5, base.float())
    torch.testing.assert_close(features[6:12].view(2, 3, 4, 5), shown.float(), rtol=0, atol=1e-3)
    torch.testing.assert_close(features[12:14] / 4, weights.float())
    torch.testing.assert_close(features[14:], torch.stack([trust, score]).float())
