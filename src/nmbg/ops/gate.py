"""The gate of gated convolutions: one half of the channels opens and closes the other."""

from __future__ import annotations

from typing import Any

import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
from torch import Tensor

from nmbg import _core
from nmbg.ops import reference
from nmbg.ops._arrays import array


def _pixels(x: Tensor) -> Tensor:
    """[B, C, H, W] as [B·H·W, C]: the channels of a pixel next to each other."""
    return x.permute(0, 2, 3, 1).reshape(-1, x.shape[1])


def _like(x: Tensor, channels: int) -> Tensor:
    size = (x.shape[0], channels, *x.shape[2:])
    return torch.empty(size, dtype=x.dtype, device=x.device, memory_format=torch.channels_last)


@torch.library.custom_op("nmbg::gate", mutates_args=(), device_types="cpu")
def _gate(x: Tensor) -> Tensor:
    out = _like(x, x.shape[1] // 2)
    _core.gate(array("x", _pixels(x)), array("out", _pixels(out)), torch.get_num_threads())
    return out


@_gate.register_fake
def _(x: Tensor) -> Tensor:
    return _like(x, x.shape[1] // 2)


@torch.library.custom_op("nmbg::gate_backward", mutates_args=(), device_types="cpu")
def _gate_backward(grad_out: Tensor, x: Tensor) -> Tensor:
    grad = _like(x, x.shape[1])
    down = array("grad_out", _pixels(grad_out))
    _core.gate_backward(array("x", _pixels(x)), down, array("grad", _pixels(grad)), torch.get_num_threads())
    return grad


@_gate_backward.register_fake
def _(grad_out: Tensor, x: Tensor) -> Tensor:
    return _like(x, x.shape[1])


def _save(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
    ctx.save_for_backward(*inputs)


def _grad(ctx: Any, grad_out: Tensor) -> Tensor:
    (x,) = ctx.saved_tensors
    grad: Tensor = _gate_backward(grad_out, x)
    return grad


_gate.register_autograd(_grad, setup_context=_save)


def gate(x: Tensor) -> Tensor:  # [B, 2C, H, W] -> [B, C, H, W]
    """ELU(value) · sigmoid(gate), in one pass forward and one back; only `x` is kept between them.

    Args:
        x: [B, 2C, H, W] float32 or float64: C values, then C gates; fastest in channels_last.

    Returns:
        [B, C, H, W] in the dtype of `x`, channels_last; differentiable.

    Raises:
        ValueError: an odd number of channels.
    """
    if x.device.type != "cpu" or x.dtype not in (torch.float32, torch.float64):
        return reference.gate(x)  # plain torch, for other devices and under autocast
    out: Tensor = _gate(x)
    return out
