"""One Adam for the network, one row-lazy Adam for the descriptors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from nmbg.model.renderer import Renderer
from nmbg.ops import adam_rows
from nmbg.training.config import Stage


class RowAdam(torch.optim.Optimizer):
    """Adam that touches only the rows of tables that have a gradient, as torch's SparseAdam, in one pass.

    A row without a gradient neither moves nor forgets; the corrections of the moments count all steps.

    The first step of a table of zeros leaves no moments. A network that normalises divides by almost nothing
    where all features are the same: the gradient has signs, but is larger than any later one by four to five
    orders of magnitude, and as a second moment it would hold back the rows that it moved for good.

    Args:
        tables: [N, C] each; their gradients are sparse in the first dimension.
        lr: learning rate.
        betas: decay of the moments.
        eps: added to the root of the second moment.
    """

    def __init__(
        self,
        tables: Sequence[Tensor],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__(tables, {"lr": lr, "betas": betas, "eps": eps})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Move every table that has a gradient."""
        for group in self.param_groups:
            betas = group["betas"]
            for table in group["params"]:
                if table.grad is None:
                    continue
                state = self.state[table]
                zeros = not state and not table.any()
                if not state:
                    state |= {
                        "step": 0,
                        "exp_avg": torch.zeros_like(table),
                        "exp_avg_sq": torch.zeros_like(table),
                    }
                state["step"] += 1
                first, second = (1 - beta ** state["step"] for beta in betas)
                rate = group["lr"] * math.sqrt(second) / first
                index, grad = _rows(table.grad)
                adam_rows(
                    table, state["exp_avg"], state["exp_avg_sq"], index, grad, rate, betas, group["eps"]
                )
                if zeros:
                    state.clear()


def _rows(grad: Tensor) -> tuple[Tensor, Tensor]:
    """Rows of a sparse gradient and their values, each row once."""
    index = grad._indices()[0]
    # Ascending as they come from one view; torch forgets that on the way, and would sort them.
    if bool((index[1:] > index[:-1]).all()):
        return index, grad._values()
    grad = grad.coalesce()
    return grad.indices()[0], grad.values()


# An optimiser and its learning rate at the stage's start.
Part = tuple[torch.optim.Optimizer, float]


def descriptors_part(renderer: Renderer, stage: Stage) -> list[Part]:
    """What trains a scene's descriptors in a stage; empty where they stay as they are.

    Their gradients are sparse: a step touches only the vertices that its view sees.
    """
    if stage.descriptor_rate == 0:
        return []
    tables = list(renderer.descriptors.parameters())
    return [(RowAdam(tables, lr=stage.descriptor_rate), stage.descriptor_rate)]


def network_part(network: nn.Module | None, stage: Stage) -> list[Part]:
    """What trains the network in a stage; empty where there is none to train."""
    if network is None or not stage.network:
        return []
    return [(torch.optim.Adam(network.parameters(), lr=stage.network_rate), stage.network_rate)]


def differentiate(loss: Tensor, parts: Sequence[Part]) -> tuple[bool, bool]:
    """Fill the gradients of what the parts train.

    Returns:
        whether loss and gradients are finite, and whether loss and sparse gradients are, which no other
        process has a share in.
    """
    for optimiser, _ in parts:
        optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    grads = [p.grad for optimiser, _ in parts for group in optimiser.param_groups for p in group["params"]]
    own = [loss, *(g._values() for g in grads if g is not None and g.is_sparse)]
    sound = finite(own)
    return sound and finite([g for g in grads if g is not None and not g.is_sparse]), sound


def finite(values: Sequence[Tensor]) -> bool:
    """Whether no value of any tensor is infinite or NaN; a sum that overflows counts as infinite."""
    return all(bool(torch.isfinite(value.sum())) for value in values)


def descend(parts: Sequence[Part], factor: float) -> None:
    """Step along the gradients, at so much of each part's rate."""
    for optimiser, rate in parts:
        for group in optimiser.param_groups:
            group["lr"] = rate * factor
        optimiser.step()
