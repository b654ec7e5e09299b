from __future__ import annotations

import pytest
import torch
from torch import Tensor

from nmbg.ops import project, reference


def matrix() -> Tensor:
    P = torch.tensor([[500.0, 0, 320, 10], [0, 510, 240, -20], [0, 0, 1, 3]], dtype=torch.float64)
    return P + 0.1 * torch.randn(3, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [0, 1, 15, 5000])
def test_agrees_with_the_twin(assert_same, dtype, count):
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(1), dtype=dtype)
    assert_same(
        lambda points: project(points, matrix()), lambda points: reference.project(points, matrix()), [points]
    )


def test_float32_is_rounded_once():
    points = torch.randn(5000, 3, generator=torch.Generator().manual_seed(2))
    exact = reference.project(points.double(), matrix())
    assert torch.equal(project(points, matrix()), project(points.double(), matrix()).float())
    assert ((project(points, matrix()) - exact).abs() <= 1.01 * 2**-24 * exact.abs() + 1e-12).all()


def test_gradient_is_the_derivative():
    points = torch.randn(7, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda points: project(points, matrix()), points)


def test_bad_input():
    with pytest.raises(ValueError, match=r"points: expected shape \[\*, 3\]"):
        project(torch.zeros(4, 2), matrix())
    with pytest.raises(TypeError, match="P: expected float64"):
        project(torch.zeros(4, 3), matrix().float())
