"""Tensors as the arrays that the kernels take."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
import torch
from torch import Tensor

_DTYPES = (torch.float32, torch.float64, torch.int32, torch.int64, torch.uint8, torch.uint16)


def array(name: str, tensor: Tensor) -> npt.NDArray[Any]:
    """The values of a CPU tensor as a C-contiguous array, shared where the tensor is contiguous.

    Raises:
        TypeError: a dtype that NumPy or the kernels do not know.
    """
    if tensor.dtype not in _DTYPES:
        raise TypeError(f"{name}: expected float32, float64 or int32, got {tensor.dtype}")
    values: npt.NDArray[Any] = tensor.detach().contiguous().numpy()
    return values
