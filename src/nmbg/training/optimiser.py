"""One Adam for the network, one row-lazy Adam for the descriptors."""

from __future__ import annotations

import torch
from torch import Tensor

from nmbg.model.renderer import Renderer
from nmbg.training.config import Stage

State = dict[str, object]


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
            descriptors = torch.optim.SparseAdam(
                list(renderer.descriptors.parameters()), lr=stage.descriptor_rate
            )
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
                group["lr"] = max(rate * factor, 1e-8)  # SparseAdam refuses zero
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
