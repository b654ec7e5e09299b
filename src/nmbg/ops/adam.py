"""A step of Adam for the rows of a table that have a gradient."""

from __future__ import annotations

import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
from torch import Tensor

from nmbg import _core
from nmbg.ops import reference
from nmbg.ops._arrays import array


@torch.library.custom_op("nmbg::adam_rows", mutates_args=("table", "mean", "square"), device_types="cpu")
def _adam_rows(
    table: Tensor,
    mean: Tensor,
    square: Tensor,
    index: Tensor,
    grad: Tensor,
    rate: float,
    beta1: float,
    beta2: float,
    eps: float,
) -> None:
    _core.adam_rows(
        array("table", table),
        array("mean", mean),
        array("square", square),
        array("index", index),
        array("grad", grad),
        rate,
        beta1,
        beta2,
        eps,
        torch.get_num_threads(),
    )


@_adam_rows.register_fake
def _(
    table: Tensor,
    mean: Tensor,
    square: Tensor,
    index: Tensor,
    grad: Tensor,
    rate: float,
    beta1: float,
    beta2: float,
    eps: float,
) -> None:
    return None


def adam_rows(
    table: Tensor,  # [N, C]
    mean: Tensor,  # [N, C]
    square: Tensor,  # [N, C]
    index: Tensor,  # [R]
    grad: Tensor,  # [R, C]
    rate: float,
    betas: tuple[float, float],
    eps: float,
) -> None:
    """Move rows of a table against their gradients, in place (Kingma & Ba 2015, algorithm 1).

    Args:
        table: [N, C] float32 or float64, contiguous; changed.
        mean: [N, C] like `table`, first moments; changed.
        square: [N, C] like `table`, second moments; changed.
        index: [R] int64, which rows, each at most once.
        grad: [R, C] like `table`, gradients of these rows.
        rate: learning rate, with the corrections of both moments.
        betas: decay of the moments.
        eps: added to the root of the second moment.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    if table.device.type != "cpu":
        reference.adam_rows(table, mean, square, index, grad, rate, betas, eps)
        return
    if not (table.is_contiguous() and mean.is_contiguous() and square.is_contiguous()):
        raise ValueError("table, mean, square: expected contiguous tensors, which are changed in place")
    _adam_rows(table, mean, square, index, grad, rate, *betas, eps)
