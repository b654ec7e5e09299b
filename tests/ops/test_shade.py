from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from nmbg.ops import reference, shade_faces, shade_points

DTYPES = (torch.float32, torch.float64)
H, W = 11, 13


def fragments(seed: int, dtype: torch.dtype, vertices: int = 40, faces: int = 30):
    g = torch.Generator().manual_seed(seed)
    index = torch.randint(-1, vertices, (H, W), generator=g, dtype=torch.int32)
    weight = torch.rand(H, W, generator=g, dtype=torch.float64).to(dtype)
    face = torch.randint(-1, faces, (H, W), generator=g, dtype=torch.int32)
    bary = torch.rand(H, W, 3, generator=g, dtype=torch.float64).to(dtype)
    table = torch.randint(0, vertices, (faces, 3), generator=g, dtype=torch.int32)
    return index, weight, face, bary, table


def coefficients(basis: int, channels: int, dtype: torch.dtype, vertices: int = 40) -> Tensor:
    g = torch.Generator().manual_seed(basis)
    return torch.randn(vertices, basis, channels, generator=g, dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("basis", [1, 4, 9])
@pytest.mark.parametrize("channels", [1, 3, 8, 12])
def test_agrees_with_the_twin(assert_same, unit_rays, dtype, basis, channels):
    index, weight, face, bary, table = fragments(basis, dtype)
    rays, coeffs = unit_rays(1, H, W, dtype), coefficients(basis, channels, dtype)
    if basis == 1:  # constant along the rays: the twin has no gradient to them
        rays = rays.detach()
        assert_same(
            lambda w, k: shade_points(index, w, rays, k),
            lambda w, k: reference.shade_points(index, w, rays, k),
            [weight, coeffs],
        )
        assert_same(
            lambda w, k: shade_faces(face, w, table, rays, k),
            lambda w, k: reference.shade_faces(face, w, table, rays, k),
            [bary, coeffs],
        )
    else:
        assert_same(shade_points, reference.shade_points, [index, weight, rays, coeffs])
        assert_same(shade_faces, reference.shade_faces, [face, bary, table, rays, coeffs])


@pytest.mark.parametrize("basis", [1, 4, 9])
def test_gradients_are_the_derivatives(unit_rays, basis):
    index, weight, face, bary, table = (
        x[:3, :4] if x.shape[:2] == (H, W) else x for x in fragments(2, torch.float64)
    )
    rays = unit_rays(3, 3, 4).requires_grad_()
    coeffs = coefficients(basis, 2, torch.float64).requires_grad_()
    weight, bary = weight.clone().requires_grad_(), bary.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda w, r, k: shade_points(index, w, r, k), (weight, rays, coeffs))
    assert torch.autograd.gradcheck(lambda b, r, k: shade_faces(face, b, table, r, k), (bary, rays, coeffs))


def kernel_harmonics(directions: Tensor) -> Tensor:
    """Basis functions as the kernel evaluates them: descriptors that are the identity. [S, 3] → [S, 9]."""
    count = directions.shape[0]
    index = torch.zeros(1, count, dtype=torch.int32)
    weight = torch.ones(1, count, dtype=torch.float64)
    return shade_points(index, weight, directions[None], torch.eye(9, dtype=torch.float64)[None])[:, 0].T


@pytest.mark.parametrize("basis_of", [kernel_harmonics, lambda d: reference.harmonics(d, 9)])
def test_harmonics_are_orthonormal(basis_of):
    # Gauss-Legendre in z times equal steps of azimuth: exact for polynomials of this degree.
    z, wz = np.polynomial.legendre.leggauss(8)
    azimuth = 2 * np.pi * np.arange(16) / 16
    r = np.sqrt(1 - z**2)[:, None]
    directions = np.stack(
        np.broadcast_arrays(r * np.cos(azimuth), r * np.sin(azimuth), z[:, None]), -1
    ).reshape(-1, 3)
    w = torch.tensor(np.repeat(wz, 16) * 2 * np.pi / 16)
    Y = basis_of(torch.tensor(directions))
    torch.testing.assert_close(Y.T @ (w[:, None] * Y), torch.eye(9, dtype=torch.float64))


def test_harmonics_follow_the_published_order_and_signs():
    x, y, z = 0.36, -0.48, 0.8
    expected = [
        0.28209479, -0.48860251 * y, 0.48860251 * z, -0.48860251 * x,
        1.09254843 * x * y, -1.09254843 * y * z, 0.31539157 * (2 * z * z - x * x - y * y),
        -1.09254843 * x * z, 0.54627422 * (x * x - y * y),
    ]  # fmt: skip
    values = kernel_harmonics(torch.tensor([[x, y, z]], dtype=torch.float64))[0]
    torch.testing.assert_close(values, torch.tensor(expected, dtype=torch.float64), rtol=0, atol=2e-8)


def test_empty_pixels_are_zero(unit_rays):
    nothing = torch.full((H, W), -1, dtype=torch.int32)
    rays = unit_rays(0, H, W)
    coeffs = torch.zeros(0, 9, 8, dtype=torch.float64, requires_grad=True)
    table = torch.zeros(0, 3, dtype=torch.int32)
    weight = torch.full((H, W), torch.nan, dtype=torch.float64)
    for module_points, module_faces in (
        (shade_points, shade_faces),
        (reference.shade_points, reference.shade_faces),
    ):
        out = module_points(nothing, weight, rays, coeffs)
        assert out.shape == (8, H, W)
        assert (out == 0).all()
        out.sum().backward()
        assert (module_faces(nothing, weight[..., None].expand(-1, -1, 3), table, rays, coeffs) == 0).all()


def test_views_that_are_not_contiguous_are_taken_as_they_are(run_op, unit_rays):
    _, _, face, bary, table = fragments(5, torch.float64)
    rays, coeffs = unit_rays(5, H, W), coefficients(4, 3, torch.float64)
    expected = run_op(shade_faces, [face, bary, table, rays, coeffs])
    strided = [x.transpose(0, 1).contiguous().transpose(0, 1) for x in (face, bary, table, rays, coeffs)]
    assert not strided[1].is_contiguous()
    for ours, theirs in zip(run_op(shade_faces, strided), expected, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            assert torch.equal(a, b)
