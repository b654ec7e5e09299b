"""The processes that train together, as torchrun starts them; without it there is one.

The network is shared, and torch's DistributedDataParallel averages its gradients; everything else belongs to
one process. What decides how training goes on is agreed upon at every step.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import TypeVar, cast

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from nmbg.errors import NmbgError
from nmbg.progress import hide_bars

T = TypeVar("T")

# One may prepare a large scene while another waits; one that has ended is noticed at once.
PATIENCE = timedelta(hours=6)


@contextmanager
def joined(device: str) -> Iterator[None]:
    """Join the processes that torchrun started, if it did: over gloo, or nccl between CUDA devices."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield
        return
    if device == "cuda":
        place, devices = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
        if place >= devices:
            raise NmbgError(f"{place + 1} processes for {devices} CUDA devices; start at most one for each")
        torch.cuda.set_device(place)
    dist.init_process_group("nccl" if device == "cuda" else "gloo", timeout=PATIENCE)
    if rank():
        hide_bars()
    try:
        yield
    finally:
        dist.destroy_process_group()


def rank() -> int:
    """Number of this process; the first is 0, and alone writes what there is one of."""
    return dist.get_rank() if dist.is_initialized() else 0


def size() -> int:
    """How many processes train together."""
    return dist.get_world_size() if dist.is_initialized() else 1


def shared(module: nn.Module) -> nn.Module:
    """The module with gradients averaged over the processes; alone, the module itself."""
    if size() == 1:
        return module
    return DistributedDataParallel(module)


def bare(module: nn.Module) -> nn.Module:
    """What shared() was given."""
    return module.module if isinstance(module, DistributedDataParallel) else module


def largest(values: Sequence[float]) -> list[float]:
    """Each value as the process has it that has the largest one."""
    return _reduced(torch.tensor(values, dtype=torch.float64), dist.ReduceOp.MAX).tolist()


def mean(values: Sequence[float]) -> list[float]:
    """Each value's mean over the processes."""
    return (_reduced(torch.tensor(values, dtype=torch.float64), dist.ReduceOp.SUM) / size()).tolist()


def wait() -> None:
    """Go on when every process has come here."""
    largest([0.0])


def gathered(value: T) -> list[T]:
    """What each process has, in their order; anything that can be pickled."""
    if size() == 1:
        return [value]
    every: list[T | None] = [None] * size()
    with others_may_end():
        dist.all_gather_object(every, value)
    return cast("list[T]", every)


@contextmanager
def others_may_end() -> Iterator[None]:
    """Say in one line that another process has ended while this one waited for it."""
    try:
        yield
    except RuntimeError as error:
        if size() == 1 or isinstance(error, torch.OutOfMemoryError):
            raise
        raise NmbgError(
            f"process {rank()} of {size()}: another one has ended ({str(error).splitlines()[0]}); the last "
            "checkpoint is whole: go on with --resume, with as many processes as scenes or fewer"
        ) from error


def _reduced(tensor: Tensor, operation: dist.ReduceOp.RedOpType) -> Tensor:
    if size() > 1:
        tensor = tensor.cuda() if dist.get_backend() == "nccl" else tensor
        with others_may_end():
            dist.all_reduce(tensor, operation)
    return tensor.cpu()
