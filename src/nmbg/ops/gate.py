"""The gate of gated convolutions: one half of the channels opens and closes the other."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
from torch import Tensor

from nmbg import _core
from nmbg.ops import reference
from nmbg.ops._arrays import array


def _pixels(name: str, x: Tensor) -> npt.NDArray[Any]:
    """[B, C, H, W] as [B·H·W, C]: the channels of a pixel next to each other; of bfloat16 the bits."""
    pixels = x.detach().permute(0, 2, 3, 1).reshape(-1, x.shape[1])
    return array(name, pixels.view(torch.uint16) if x.dtype == torch.bfloat16 else pixels)


def _like(x: Tensor, channels: int) -> Tensor:
    size = (x.shape[0], channels, *x.shape[2:])
    return torch.empty(size, dtype=x.dtype, device=x.device, memory_format=torch.channels_last)


@torch.library.custom_op("nmbg::gate", mutates_args=(), device_types="cpu")
def _gate(x: Tensor) -> Tensor:
    out = _like(x, x.shape[1] // 2)
    _core.gate(_pixels("x", x), _pixels("out", out), torch.get_num_threads())
    return out


@_gate.register_fake
def _(x: Tensor) -> Tensor:
    return _like(x, x.shape[1] // 2)


@torch.library.custom_op("nmbg::gate_backward", mutates_args=(), device_types="cpu")
def _gate_backward(grad_out: Tensor, x: Tensor) -> Tensor:
    grad = _like(x, x.shape[1])
    parts = _pixels("x", x), _pixels("grad_out", grad_out), _pixels("grad", grad)
    _core.gate_backward(*parts, torch.get_num_threads())
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
        x: [B, 2C, H, W] float32, float64 or bfloat16: C values, then C gates; fastest in channels_last.
            Of bfloat16, each number is computed in float32 and rounded once.

    Returns:
        [B, C, H, W] in the dtype of `x`, channels_last; differentiable.

    Raises:
        ValueError: an odd number of channels.
    """
    if x.device.type != "cpu" or x.dtype not in (torch.float32, torch.float64, torch.bfloat16):
        return reference.gate(x)  # plain torch, for other devices
    out: Tensor = _gate(x)
    return out
