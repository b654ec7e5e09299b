"""Descriptors in 8 bits, of each vertex only the harmonics that it has; all other weights in bfloat16."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from nmbg.model.descriptors import degrees_of

PACKED = ("degrees", "values", "scales", "offsets", "bases")


def pack(state: Mapping[str, Tensor], bases: int) -> dict[str, Tensor]:
    """Tables of descriptors [N, bases · features] as degrees, values in 8 bits, and scales.

    Args:
        state: of Descriptors, by layer: names end in "coeffs".
        bases: harmonics of a feature.
    """
    packed: dict[str, Tensor] = {}
    for name, coeffs in state.items():
        degrees = degrees_of(coeffs, bases)
        columns = coeffs.shape[1]
        own = _own(degrees, columns, bases)
        low = torch.stack([_least(coeffs[own[:, c], c]) for c in range(columns)])
        high = torch.stack([-_least(-coeffs[own[:, c], c]) for c in range(columns)])
        scales = (high - low).clamp(min=1e-12) / 255
        values = ((coeffs - low) / scales).round().clamp(0, 255).to(torch.uint8)[own]
        parts = (degrees.to(torch.uint8), values, scales, low, torch.tensor(bases))
        packed |= {f"{name}.{part}": tensor for part, tensor in zip(PACKED, parts, strict=True)}
    return packed


def unpack(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """What was packed, in float32; any other state in float32, too."""
    names = {name.rpartition(".")[0] for name in state if name.endswith(f".{PACKED[0]}")}
    whole = {name: tensor for name, tensor in state.items() if name.rpartition(".")[0] not in names}
    loaded = {n: t.float() if t.dtype == torch.bfloat16 else t for n, t in whole.items()}
    for name in names:
        degrees, values, scales, low, bases = (state[f"{name}.{part}"] for part in PACKED)
        own = _own(degrees.long(), len(scales), int(bases))
        coeffs = torch.zeros(own.shape)
        coeffs[own] = (values * scales.expand_as(own)[own]) + low.expand_as(own)[own]
        loaded[name] = coeffs
    return loaded


def halved(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Floating weights in bfloat16."""
    return {n: t.to(torch.bfloat16) if t.is_floating_point() else t for n, t in state.items()}


def _own(degrees: Tensor, columns: int, bases: int) -> Tensor:
    """Which coefficients a vertex of its degree has, [N, bases · features] bool."""
    basis = torch.arange(columns) // (columns // bases)
    return basis < (degrees[:, None] + 1) ** 2


def _least(values: Tensor) -> Tensor:
    return values.min() if len(values) else values.new_zeros(())
