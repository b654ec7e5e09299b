"""Random scenes, and one way to compare implementations of an op."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
import torch
from torch import Tensor

# Largest differences that rounding explains, relative to the largest value.
TOLERANCE = {torch.float32: 2e-5, torch.float64: 1e-11}

Op = Callable[..., Tensor | tuple[Tensor, ...]]


def run(op: Op, inputs: Sequence[Any], seed: int = 0) -> tuple[list[Tensor], list[Tensor]]:
    """Outputs of an op, and gradients of a random sum of them to the floating-point inputs."""
    inputs = [
        x.detach().clone().requires_grad_() if isinstance(x, Tensor) and x.is_floating_point() else x
        for x in inputs
    ]
    result = op(*inputs)
    outputs = list(result) if isinstance(result, tuple) else [result]
    generator = torch.Generator().manual_seed(seed)
    smooth = [o for o in outputs if o.is_floating_point()]
    weights = [torch.randn(o.shape, generator=generator, dtype=torch.float64).to(o.dtype) for o in smooth]
    torch.autograd.backward(smooth, weights)
    grads = [x.grad for x in inputs if isinstance(x, Tensor) and x.is_floating_point()]
    return [o.detach() for o in outputs], [torch.zeros(0) if g is None else g for g in grads]


@pytest.fixture
def run_op() -> Callable[..., tuple[list[Tensor], list[Tensor]]]:
    return run


@pytest.fixture
def assert_same() -> Callable[[Op, Op, Sequence[Any]], None]:
    """Assert that two implementations give equal indices, and equal values and gradients within rounding."""

    def compare(op: Op, twin: Op, inputs: Sequence[Any]) -> None:
        dtype = next(x.dtype for x in inputs if isinstance(x, Tensor) and x.is_floating_point())
        for ours, theirs in zip(run(op, inputs), run(twin, inputs), strict=True):
            for a, b in zip(ours, theirs, strict=True):
                assert a.dtype == b.dtype
                assert a.shape == b.shape
                if a.is_floating_point():
                    scale = max(1.0, float(b.abs().max())) if b.numel() else 1.0
                    torch.testing.assert_close(a / scale, b / scale, rtol=0, atol=TOLERANCE[dtype])
                else:
                    assert torch.equal(a, b)

    return compare


@pytest.fixture
def random_scene() -> Callable[..., tuple[Tensor, Tensor]]:
    """Vertices in homogeneous pixels on both sides of the camera plane, and faces over them at random."""

    def make(
        seed: int,
        height: int,
        width: int,
        vertices: int = 60,
        faces: int = 80,
        dtype: torch.dtype = torch.float64,
    ) -> tuple[Tensor, Tensor]:
        g = torch.Generator().manual_seed(seed)
        z = torch.rand(vertices, generator=g, dtype=torch.float64) * 4 - 1
        u = torch.rand(vertices, generator=g, dtype=torch.float64) * 2 - 0.5
        v = torch.rand(vertices, generator=g, dtype=torch.float64) * 2 - 0.5
        h = torch.stack([u * width * z, v * height * z, z], 1).to(dtype)
        return h, torch.randint(0, vertices, (faces, 3), generator=g, dtype=torch.int32)

    return make


@pytest.fixture
def unit_rays() -> Callable[..., Tensor]:
    def make(seed: int, height: int, width: int, dtype: torch.dtype = torch.float64) -> Tensor:
        g = torch.Generator().manual_seed(seed)
        rays = torch.randn(height, width, 3, generator=g, dtype=torch.float64)
        return torch.nn.functional.normalize(rays, dim=-1).to(dtype)

    return make


@pytest.fixture
def each_thread_count() -> Iterator[Callable[[Callable[[], list[Tensor]]], list[list[Tensor]]]]:
    """Run a function with 1, 2, 3 and 7 threads; put the number back in the end."""
    before = torch.get_num_threads()

    def results(function: Callable[[], list[Tensor]]) -> list[list[Tensor]]:
        found = []
        for threads in (1, 2, 3, 7):
            torch.set_num_threads(threads)
            found.append(function())
        return found

    yield results
    torch.set_num_threads(before)
