from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nmbg.ops import rasterize_points, rasterize_points_pyramid, reference

DTYPES = (torch.float32, torch.float64)
BOTH = pytest.mark.parametrize("op", [rasterize_points, reference.rasterize_points])


def points(*uvz: tuple[float, float, float], dtype: torch.dtype = torch.float64) -> Tensor:
    rows = torch.tensor(uvz, dtype=dtype)
    return torch.cat([rows[:, :2] * rows[:, 2:], rows[:, 2:]], 1)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("radius", [0.5, 1.63, 3.24, 40.0])
def test_agrees_with_the_twin(assert_same, random_scene, dtype, radius):
    for seed in range(3):
        h, _ = random_scene(seed, 37, 53, vertices=200, dtype=dtype)
        assert_same(rasterize_points, reference.rasterize_points, [h, radius, 37, 53])


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("count", [1, 9, 513, 5000])
@pytest.mark.parametrize(("height", "width", "levels"), [(37, 53, 4), (16, 32, 5), (5, 2, 9)])
def test_a_pyramid_agrees_with_its_levels_and_with_the_twin(
    assert_same, random_scene, dtype, count, height, width, levels
):
    h, _ = random_scene(levels, height, width, vertices=count, dtype=dtype)

    def flat_parts(op):
        def parts(h: Tensor) -> tuple[Tensor, ...]:
            return tuple(part for hits in op(h, 1.4, height, width, levels) for part in hits)

        return parts

    assert_same(flat_parts(rasterize_points_pyramid), flat_parts(reference.rasterize_points_pyramid), [h])
    for k, hits in enumerate(rasterize_points_pyramid(h, 1.4, height, width, levels)):
        halved = h * h.new_tensor([0.5**k, 0.5**k, 1])
        alone = rasterize_points(halved, 1.4, -(-height // 2**k), -(-width // 2**k))
        for part, whole in zip(hits, alone, strict=True):
            assert torch.equal(part, whole)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("radius", [0.37, 0.5, 0.81, 1.62, 3.24, 8.1])
def test_what_crowded_levels_leave_out_would_not_be_seen(dtype, radius):
    g = torch.Generator().manual_seed(0)
    u, v, noise = torch.rand(3, 20_000, generator=g, dtype=torch.float64)
    z = 1 + u + 0.3 * v + torch.where(noise < 0.5, 0, 0.2 * noise)  # a slope, and what is behind it
    z = (64 * z).round() / 64  # many are equally near
    h = torch.stack([(50 * u - 3) * z, (40 * v - 3) * z, z], 1).to(dtype)
    for k, hits in enumerate(rasterize_points_pyramid(h, radius, 33, 43, 5)):
        halved = h * h.new_tensor([0.5**k, 0.5**k, 1])
        alone = rasterize_points(halved, radius, -(-33 // 2**k), -(-43 // 2**k))
        for part, whole in zip(hits, alone, strict=True):
            assert torch.equal(part, whole)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("order", ["along rows", "any"])
@pytest.mark.parametrize("radius", [0.6, 2.3])
def test_what_is_left_out_as_hidden_would_not_be_seen(dtype, order, radius):
    # Two sides of a closed surface, a third behind both that is seen through a hole; many equally near.
    v, u = torch.meshgrid(torch.arange(-2, 40, 0.5), torch.arange(-2, 75, 0.5), indexing="ij")
    holed = (u - 30).square() + (v - 20).square() > 60
    sides = [(u[holed], v[holed], 1.0), (u[holed] + 0.2, v[holed], 2.0), (u.flatten(), v.flatten(), 2.0)]
    parts = [(a, b, z + 0.125 * (a / 8).sin().round()) for a, b, z in sides]
    h = torch.cat([torch.stack([a * z, b * z, z], 1) for a, b, z in parts]).to(dtype)
    h[5::97], h[6::97, 2], h[7::97, 0], h[8::97, 2], h[9::97, 2] = math.nan, -1, math.inf, math.inf, 1e-40
    if order == "any":
        h = h[torch.randperm(len(h), generator=torch.Generator().manual_seed(0))]
    found, expected = rasterize_points(h, radius, 37, 70), reference.rasterize_points(h, radius, 37, 70)
    assert (expected.point.unique() >= 0).sum() > 500
    assert torch.equal(found.point, expected.point)
    torch.testing.assert_close(found.dist2, expected.dist2)


def test_gradient_is_the_derivative(random_scene):
    h, _ = random_scene(1, 6, 7, vertices=12)

    def dist2(h: Tensor) -> tuple[Tensor, ...]:
        return tuple(hits.dist2 for hits in rasterize_points_pyramid(h, 1.5, 6, 7, 2))

    assert (dist2(h)[0] > 0).sum() > 5
    assert torch.autograd.gradcheck(dist2, h.requires_grad_(), eps=1e-7, atol=1e-4)


@BOTH
@pytest.mark.parametrize("dtype", DTYPES)
def test_the_radius_is_strict(op, dtype):
    # The pixel centre (4.5, 2.5) is exactly 1.5 px to the left of the point.
    h = points((6.0, 2.5, 2.0), dtype=dtype)
    assert op(h, 1.5, 5, 10)[0][2].tolist() == [-1, -1, -1, -1, -1, 0, 0, -1, -1, -1]
    index, dist2 = op(h, math.nextafter(1.5, 2) if dtype == torch.float64 else 1.5001, 5, 10)
    assert index[2].tolist() == [-1, -1, -1, -1, 0, 0, 0, 0, -1, -1]
    assert dist2[2, 4:8].tolist() == [2.25, 0.25, 0.25, 2.25]


@BOTH
def test_a_point_on_a_pixel_centre(op):
    index, dist2 = op(points((3.5, 1.5, 1.0)), 0.5, 4, 6)
    assert (index >= 0).nonzero().tolist() == [[1, 3]]
    assert (dist2 == 0).all()


@BOTH
def test_nearest_wins_and_ties_go_to_the_lower_index(op):
    h = points((2.5, 2.5, 3.0), (2.5, 2.5, 2.0), (2.6, 2.4, 2.0), (2.5, 2.5, 4.0))
    assert (op(h, 1.0, 5, 5)[0][2, 2]) == 1
    assert (op(h.flip(0), 1.0, 5, 5)[0][2, 2]) == 1


@BOTH
@pytest.mark.parametrize("dtype", DTYPES)
def test_what_cannot_be_drawn_is_left_out(op, dtype):
    nan, inf = math.nan, math.inf
    rows = [[nan, 1, 1], [1, nan, 1], [1, 1, nan], [inf, 1, 1], [1, -inf, 1], [1, 1, inf]]
    rows += [[0, 0, 0], [-2, -2, -1], [1e30, 1e30, 1e-30], [2, 2, -inf]]
    h = torch.tensor(rows, dtype=dtype).requires_grad_()
    index, dist2 = op(h, 2.0, 4, 4)
    assert (index == -1).all()
    assert (dist2 == 0).all()
    if op is rasterize_points:
        dist2.sum().backward()
        assert (h.grad == 0).all()


@BOTH
def test_no_points(op):
    index, dist2 = op(torch.zeros(0, 3, requires_grad=True), 1.0, 2, 3)
    assert (index == -1).all()
    assert (dist2 == 0).all()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 65536), (65536, 1), (2, 300), (100, 3)])
def test_images_of_any_shape(height, width):
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    h = torch.stack([columns + 0.5, rows + 0.5, torch.ones(height, width)], -1).reshape(-1, 3)
    index, _ = rasterize_points(h, 0.5, height, width)
    assert torch.equal(index.flatten(), torch.arange(height * width, dtype=torch.int32))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6), radius=st.floats(0.1, 30), height=st.integers(1, 40), width=st.integers(1, 40)
)
def test_pixels_see_what_is_within_reach_and_nothing_nearer(seed, radius, height, width):
    g = torch.Generator().manual_seed(seed)
    uvz = torch.rand(30, 3, generator=g, dtype=torch.float64) * torch.tensor([width, height, 1.0]) + 0.1
    h = torch.cat([uvz[:, :2] * uvz[:, 2:], uvz[:, 2:]], 1)
    index, dist2 = rasterize_points(h, radius, height, width)
    x, y = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    d2 = (uvz[:, 0, None, None] - x) ** 2 + (uvz[:, 1, None, None] - y[:, None]) ** 2
    within = d2 < radius**2 * (1 - 1e-9)
    assert torch.equal((index >= 0) | ~within.any(0), torch.ones(height, width, dtype=torch.bool))
    seen = index >= 0
    assert (dist2[seen] < radius**2).all()
    z = torch.where(within, uvz[:, 2, None, None], torch.inf)
    assert (uvz[:, 2][index[seen].long()] <= z.amin(0)[seen]).all()
