from __future__ import annotations

import pytest
import torch

from nmbg.model.unet import UNet
from nmbg.ops import adam_rows, reference
from nmbg.training.optimiser import RowAdam

DTYPES = (torch.float32, torch.float64)


def tables(dtype: torch.dtype, rows: int, width: int) -> list[torch.Tensor]:
    g = torch.Generator().manual_seed(0)
    table, mean, square = (torch.randn(rows, width, generator=g, dtype=torch.float64) for _ in range(3))
    return [table.to(dtype), mean.to(dtype), square.abs().to(dtype)]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("rows", "width", "chosen"), [(5, 3, 2), (9000, 72, 5000), (40, 27, 0), (1, 1, 1)])
def test_agrees_with_the_twin(dtype: torch.dtype, rows: int, width: int, chosen: int) -> None:
    g = torch.Generator().manual_seed(1)
    index = torch.randperm(rows, generator=g)[:chosen]
    grad = torch.randn(chosen, width, generator=g, dtype=torch.float64).to(dtype)
    ours, theirs = tables(dtype, rows, width), tables(dtype, rows, width)
    adam_rows(*ours, index, grad, 0.01, (0.9, 0.999), 1e-8)
    reference.adam_rows(*theirs, index, grad, 0.01, (0.9, 0.999), 1e-8)
    for a, b, before in zip(ours, theirs, tables(dtype, rows, width), strict=True):
        torch.testing.assert_close(a, b)
        untouched = torch.ones(rows, dtype=torch.bool)
        untouched[index] = False
        assert torch.equal(a[untouched], before[untouched])
        assert chosen == 0 or not torch.equal(a[index], before[index])


def test_what_zeros_are_moved_by_does_not_hold_back_later_steps() -> None:
    """Features that are all the same are divided by almost nothing on the way to a loss."""
    torch.manual_seed(0)
    network = UNet(1, 4, (8, 16, 24)).double()
    table = torch.nn.Parameter(torch.zeros(64, 4, dtype=torch.float64))
    optimiser = RowAdam([table], lr=0.1)
    moved, largest = [], []
    for _ in range(60):
        before, target = table.detach().clone(), torch.rand(1, 3, 8, 8, dtype=torch.float64)
        features = table.T.reshape(1, 4, 8, 8)
        pyramid = [torch.nn.functional.avg_pool2d(features, 2**k) for k in range(3)]
        (grad,) = torch.autograd.grad((network([pyramid]) - target).square().mean(), table)
        table.grad = grad.to_sparse(1)
        optimiser.step()
        moved.append(float((table.detach() - before).abs().median()))
        largest.append(float(grad.abs().max()))
    assert largest[0] > 1e2 * max(largest[1:])
    assert min(moved) > 0.005


def test_moves_as_torchs_own_sparse_adam() -> None:
    start = tables(torch.float64, 30, 5)[0]
    ours, theirs = (torch.nn.Parameter(start.clone()) for _ in range(2))
    optimisers = [RowAdam([ours], lr=0.02), torch.optim.SparseAdam([theirs], lr=0.02)]
    g = torch.Generator().manual_seed(2)
    for step in range(7):
        # As autograd leaves them: not known to be sorted, and at times with rows twice.
        index = torch.randint(30, (11,), generator=g)
        index = index if step % 2 else index.unique()
        grad = torch.randn(len(index), 5, generator=g, dtype=torch.float64)
        for table, optimiser in zip((ours, theirs), optimisers, strict=True):
            table.grad = torch.sparse_coo_tensor(index[None], grad, table.shape, check_invariants=True)
            optimiser.step()
    torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)


def test_bad_input_changes_nothing() -> None:
    table, mean, square = tables(torch.float32, 4, 2)
    before = table.clone()
    grad = torch.ones(2, 2)
    for index in ([0, 4], [-1, 0]):
        with pytest.raises(ValueError, match="index: expected rows from 0 to 3"):
            adam_rows(table, mean, square, torch.tensor(index), grad, 0.1, (0.9, 0.999), 1e-8)
    with pytest.raises(ValueError, match=r"grad: .*\[2, 2\].*\[3, 2\]"):
        adam_rows(table, mean, square, torch.tensor([0, 1]), torch.ones(3, 2), 0.1, (0.9, 0.999), 1e-8)
    with pytest.raises(ValueError, match="contiguous"):
        adam_rows(table.T, mean, square, torch.tensor([0]), grad, 0.1, (0.9, 0.999), 1e-8)
    assert torch.equal(table, before)


def test_torch_library_contract() -> None:
    table, mean, square = tables(torch.float64, 6, 3)
    index, grad = torch.tensor([1, 4]), torch.ones(2, 3, dtype=torch.float64)
    arguments = (table, mean, square, index, grad, 0.1, 0.9, 0.999, 1e-8)
    torch.library.opcheck(torch.ops.nmbg.adam_rows.default, arguments)
