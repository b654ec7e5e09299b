"""One Adam for the network, one row-lazy Adam for the descriptors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from nmbg.model.renderer import Renderer
from nmbg.ops import adam_rows
from nmbg.training.config import Stage

State = dict[str, object]


class RowAdam(torch.optim.Optimizer):
    """Adam that touches only the rows of tables that have a gradient, as torch's SparseAdam, in one pass.

    A row without a gradient neither moves nor forgets; the corrections of the moments count all steps.

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


def _rows(grad: Tensor) -> tuple[Tensor, Tensor]:
    """Rows of a sparse gradient and their values, each row once."""
    index = grad._indices()[0]
    # Ascending as they come from one view; torch forgets that on the way, and would sort them.
    if bool((index[1:] > index[:-1]).all()):
        return index, grad._values()
    grad = grad.coalesce()
    return grad.indices()[0], grad.values()


class Optimiser:
    """Both optimisers of a stage, their learning rates and their state.

    The descriptors' gradients are sparse: a step touches only the vertices that its view sees.

    Args:
        renderer: what is trained.
        stage: rates and decay.
    """

    def __init__(self, renderer: Renderer, stage: Stage) -> None:
        self.stage = stage
        self.parts: list[tuple[torch.optim.Optimizer, float]] = []
        if stage.descriptor_rate > 0:
            descriptors = RowAdam(list(renderer.descriptors.parameters()), lr=stage.descriptor_rate)
            self.parts.append((descriptors, stage.descriptor_rate))
        if stage.network and renderer.network is not None:
            network = torch.optim.Adam(renderer.network.parameters(), lr=stage.network_rate)
            self.parts.append((network, stage.network_rate))

    def step(self, loss: Tensor, done: float) -> None:
        """Descend once.

        Args:
            loss: scalar.
            done: share of the stage that is over, in [0, 1].
        """
        factor = 1 - done if self.stage.decay else 1.0
        for optimiser, rate in self.parts:
            optimiser.zero_grad(set_to_none=True)
            for group in optimiser.param_groups:
                group["lr"] = rate * factor
        loss.backward()  # type: ignore[no-untyped-call]
        for optimiser, _ in self.parts:
            optimiser.step()

    def state_dict(self) -> list[State]:
        """State of both, for a checkpoint."""
        return [optimiser.state_dict() for optimiser, _ in self.parts]

    def load_state_dict(self, states: list[State]) -> None:
        """Continue from a checkpoint."""
        for (optimiser, _), state in zip(self.parts, states, strict=True):
            optimiser.load_state_dict(state)
