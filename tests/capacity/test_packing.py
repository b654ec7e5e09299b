import pytest
import torch

from nmbg.capacity.packing import halved, pack, unpack
from nmbg.model.descriptors import degrees_of


@pytest.mark.parametrize("bases", [1, 4, 9])
def test_descriptors_come_back_to_half_a_step_and_keep_their_degrees(bases: int) -> None:
    generator = torch.Generator().manual_seed(bases)
    coeffs = torch.randn(60, bases, 3, generator=generator) * torch.tensor([1.0, 10.0, 0.1])
    if bases == 9:
        coeffs[10:20, 4:] = 0
    coeffs[:10, 1:] = 0
    state = {"0.coeffs": coeffs.flatten(1)}
    packed = pack(state, bases)
    loaded = unpack(packed)["0.coeffs"]
    steps = packed["0.coeffs.scales"]
    assert ((loaded - state["0.coeffs"]).abs() <= steps / 2 + 1e-6).all()
    own = degrees_of(coeffs.flatten(1), bases)
    assert torch.equal(packed["0.coeffs.degrees"].long(), own)
    assert len(packed["0.coeffs.values"]) == 3 * int((own + 1).square().sum())
    # What a vertex does not have stays exactly 0.
    assert (loaded[:10].view(10, bases, 3)[:, 1:] == 0).all()


def test_networks_are_halved_and_counters_are_not() -> None:
    state = {"weight": torch.rand(8), "count": torch.tensor(3)}
    small = halved(state)
    assert small["weight"].nbytes == state["weight"].nbytes // 2
    assert small["count"].dtype == torch.int64
    loaded = unpack(small)
    assert loaded["weight"].dtype == torch.float32
    assert torch.allclose(loaded["weight"], state["weight"], rtol=2**-8)
