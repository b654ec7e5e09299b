from __future__ import annotations

import pytest
import torch
from torch import Tensor

from nmbg.ops import pixel_rays, project, reference


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


INVERSE = torch.tensor([[0.002, 1e-4, -0.6], [-2e-4, 0.0019, -0.5], [1e-5, -3e-5, 1.1]], dtype=torch.float64)


@pytest.mark.parametrize(("dtype", "error"), [(torch.float32, 3e-7), (torch.float64, 1e-15)])
@pytest.mark.parametrize("size", [(1, 1), (3, 17), (120, 64), (9, 501)])
def test_rays_agree_with_the_twin(dtype, error, size):
    rays = pixel_rays(INVERSE, *size, dtype)
    assert rays.shape == (*size, 3)
    assert rays.dtype == dtype
    twin = reference.pixel_rays(INVERSE, *size, torch.float64)
    torch.testing.assert_close(rays.double(), twin, rtol=0, atol=error)


def test_rays_do_not_depend_on_threads(each_thread_count):
    first, *others = each_thread_count(lambda: [pixel_rays(INVERSE, 37, 91)])
    assert others
    assert all(torch.equal(first[0], other[0]) for other in others)


def test_rays_of_bad_input():
    with pytest.raises(ValueError, match=r"M: expected shape \[3, 3\]"):
        pixel_rays(INVERSE[:2], 4, 4)
    with pytest.raises(TypeError, match="M: expected float64"):
        pixel_rays(INVERSE.float(), 4, 4)
    with pytest.raises(TypeError, match="dtype: expected float32 or float64"):
        pixel_rays(INVERSE, 4, 4, torch.float16)
    with pytest.raises(ValueError, match="height"):
        pixel_rays(INVERSE, 0, 4)
