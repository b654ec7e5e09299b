"""Which precision the machine is faster in."""

from __future__ import annotations

import time
from functools import cache

import torch
from torch import nn

from nmbg.training import processes

GAIN = 0.85  # of float32's time: what bfloat16 must stay below to be worth its digits
REPEATS = 20


def bf16_is_faster(device: str) -> bool:
    """Whether convolutions are faster in bfloat16 than in float32.

    Processors that list the same instructions differ: beside float32, AVX-512's bfloat16 takes half the time
    on one and twice on the next (docs/performance.md). So it is measured, once, in a tenth of a second;
    several processes agree.

    Args:
        device: "cpu" or "cuda".
    """
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    half, full = _seconds()
    return bool(processes.largest([half < GAIN * full])[0])


@cache
def _seconds() -> tuple[float, float]:
    """The shortest times of a convolution, forward and backward, in bfloat16 and in float32."""
    with torch.random.fork_rng():  # the run's own numbers do not depend on it
        convolution, image = nn.Conv2d(64, 64, 3, padding=1), torch.randn(1, 64, 96, 96)
    image = image.to(memory_format=torch.channels_last)
    convolution.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    best = [float("inf"), float("inf")]
    for _ in range(REPEATS):
        for i, enabled in enumerate((True, False)):
            start = time.perf_counter()
            with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
                convolution(image).sum().backward()
            best[i] = min(best[i], time.perf_counter() - start)
    return best[0], best[1]
