from __future__ import annotations

import pytest
import torch

from nmbg.ops import gate, reference

DTYPES = (torch.float32, torch.float64)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("channels", [1, 3, 16, 45])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_agrees_with_the_twin(assert_same, dtype, channels, layout):
    g = torch.Generator().manual_seed(channels)
    x = 6 * torch.randn(2, 2 * channels, 5, 7, generator=g, dtype=torch.float64).to(dtype)
    assert_same(gate, reference.gate, [x.contiguous(memory_format=layout)])


def test_bfloat16_is_computed_in_float32_and_rounded_once():
    g = torch.Generator().manual_seed(0)
    x = (6 * torch.randn(1, 90, 5, 7, generator=g)).bfloat16().requires_grad_()
    down = torch.randn(1, 45, 5, 7, generator=g).bfloat16()
    exact = x.detach().double().requires_grad_()
    found, expected = gate(x), gate(exact)
    (found_grad,) = torch.autograd.grad(found, x, down)
    (expected_grad,) = torch.autograd.grad(expected, exact, down.double())
    for ours, theirs in ((found, expected), (found_grad, expected_grad)):
        assert ours.dtype == torch.bfloat16
        # 1 − sigmoid loses digits in float32 where a gate is wide open; torch itself agrees in 78 %.
        assert (ours == theirs.bfloat16()).float().mean() > 0.97
        torch.testing.assert_close(ours.double(), theirs, rtol=2**-7, atol=1e-4)


def test_gradients_are_the_derivatives():
    x = torch.randn(1, 6, 3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert torch.autograd.gradcheck(gate, x.requires_grad_())


@pytest.mark.parametrize("dtype", [*DTYPES, torch.bfloat16])
def test_extreme_values(dtype):
    far = torch.tensor([-1e30, -200.0, -88.0, -1e-8, -0.0, 0.0, 1e-8, 88.0, 200.0, 1e30], dtype=dtype)
    value, opening = (part.flatten() for part in torch.meshgrid(far, far, indexing="ij"))
    x = torch.stack([value, opening])[None, :, None]
    torch.testing.assert_close(gate(x), reference.gate(x), rtol=1e-6, atol=2e-7)
    for broken in ([torch.nan, 0.0], [0.0, torch.nan]):
        assert gate(torch.tensor(broken, dtype=dtype).view(1, 2, 1, 1)).isnan().all()


def test_same_bits_for_any_number_of_threads(each_thread_count):
    x = torch.randn(1, 32, 70, 90, generator=torch.Generator().manual_seed(1), requires_grad=True)
    first, *others = each_thread_count(lambda: [gate(x), *torch.autograd.grad(gate(x).square().sum(), x)])
    for other in others:
        assert all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_an_odd_number_of_channels_is_an_error():
    with pytest.raises(ValueError, match="even number"):
        gate(torch.ones(1, 3, 2, 2))


def test_torch_library_contract():
    x = torch.randn(1, 4, 3, 5, dtype=torch.float64).contiguous(memory_format=torch.channels_last)
    torch.library.opcheck(torch.ops.nmbg.gate.default, (x.requires_grad_(),))
