"""bfloat16 where it is faster, and only there."""

import pytest
import torch

from nmbg.training import precision
from nmbg.training.precision import bf16_is_faster


@pytest.mark.parametrize(("half", "faster"), [(0.5, True), (0.84, True), (0.95, False), (2.0, False)])
def test_the_clock_decides(monkeypatch: pytest.MonkeyPatch, half: float, faster: bool) -> None:
    monkeypatch.setattr(precision, "_seconds", lambda: (half, 1.0))
    assert bf16_is_faster("cpu") is faster


def test_measuring_leaves_random_numbers_alone() -> None:
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    precision._seconds.cache_clear()
    bf16_is_faster("cpu")
    assert torch.equal(torch.rand(4), expected)
