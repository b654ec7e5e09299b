"""The adversarial term L_GAN of the loss (paper, section 3.4): a discriminator and its own optimiser."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.model.discriminator import Discriminator, size_for
from nmbg.training.config import TrainConfig
from nmbg.training.optimiser import finite
from nmbg.training.processes import shared

RATE = 1e-4  # paper, section 3.4: as the renderer's


class Adversary:
    """Judges renders and photographs, and learns to tell them apart.

    Both are judged in a random square of the largest side, resampled to the discriminator's size.

    Args:
        size: the discriminator's, 256 or 512 pixels.
        device: where it runs.
    """

    def __init__(self, size: int, device: str) -> None:
        self.discriminator = Discriminator(size).to(device)
        self.judge = shared(self.discriminator)
        self.optimiser = torch.optim.Adam(self.discriminator.parameters(), lr=RATE)

    def term(self, render: Tensor, generator: torch.Generator) -> Tensor:
        """Non-saturating loss of a render [1, 3, H, W], a scalar; the discriminator keeps no gradient."""
        self.discriminator.requires_grad_(False)
        logits = self.discriminator(self._square(render, generator))
        self.discriminator.requires_grad_(True)
        return F.binary_cross_entropy_with_logits(logits, torch.ones_like(logits))

    def learn(self, render: Tensor, photograph: Tensor, generator: torch.Generator) -> Tensor:
        """One step of the discriminator, unless its gradients are not finite; its loss.

        Args:
            render: [1, 3, H, W]; taken as it is, no gradient goes back into it.
            photograph: [1, 3, h, w], of any size.
            generator: source of the random squares.
        """
        self.optimiser.zero_grad(set_to_none=True)
        both = [self._square(photograph, generator), self._square(render.detach(), generator)]
        logits = self.judge(torch.cat(both))
        loss = 2 * F.binary_cross_entropy_with_logits(logits, logits.new_tensor([1.0, 0.0]))
        loss.backward()  # type: ignore[no-untyped-call]
        # Averaged over the processes: all of them step, or none.
        if finite([p.grad for p in self.discriminator.parameters() if p.grad is not None]):
            self.optimiser.step()
        return loss.detach()

    def _square(self, image: Tensor, generator: torch.Generator) -> Tensor:
        height, width = image.shape[-2:]
        side = min(height, width)
        y = int(torch.randint(height - side + 1, (), generator=generator))
        x = int(torch.randint(width - side + 1, (), generator=generator))
        square = image[..., y : y + side, x : x + side].float()
        size = self.discriminator.size
        return F.interpolate(square, (size, size), mode="bilinear", antialias=True)

    def state_dict(self) -> dict[str, Any]:
        """State of both, for a checkpoint."""
        return {"weights": self.discriminator.state_dict(), "optimiser": self.optimiser.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint."""
        self.discriminator.load_state_dict(state["weights"])
        self.optimiser.load_state_dict(state["optimiser"])


def adversary_for(width: int, height: int, config: TrainConfig) -> Adversary:
    """The adversary of a run for renders of width × height pixels, with seeded weights."""
    torch.manual_seed(config.seed)
    return Adversary(size_for(width, height), config.device)
