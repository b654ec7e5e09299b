from pathlib import Path

import pytest
import torch

from nmbg.training.adversary import Adversary


@pytest.fixture
def adversary() -> Adversary:
    torch.manual_seed(0)
    return Adversary(256, "cpu")


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_generators_term_leaves_no_gradient_with_the_discriminator(adversary: Adversary) -> None:
    render = torch.rand(1, 3, 40, 60, requires_grad=True)
    adversary.term(render, generator()).backward()
    assert render.grad is not None
    assert render.grad.abs().sum() > 0
    assert all(p.grad is None for p in adversary.discriminator.parameters())


def test_the_discriminators_step_leaves_no_gradient_with_the_render(adversary: Adversary) -> None:
    render = torch.rand(1, 3, 40, 60, requires_grad=True)
    adversary.learn(2 * render, torch.rand(1, 3, 40, 60), generator())
    assert render.grad is None


def test_only_the_largest_square_is_judged(adversary: Adversary) -> None:
    render = torch.rand(1, 3, 40, 60, requires_grad=True)
    adversary.term(render, generator(3)).backward()
    assert render.grad is not None
    seen = (render.grad.abs().sum((0, 1)) > 0).nonzero()
    assert (seen.amax(0) - seen.amin(0) + 1).tolist() == [40, 40]


def test_it_learns_to_tell_renders_from_photographs(adversary: Adversary) -> None:
    """Dark against bright: the loss of both falls well below that of guessing, 2 ln 2."""
    for step in range(30):
        loss = adversary.learn(
            torch.full((1, 3, 64, 64), 0.2), torch.full((1, 3, 64, 64), 0.8), generator(step)
        )
    assert loss < 0.2
    assert adversary.term(torch.full((1, 3, 64, 64), 0.2), generator()) > 1
    assert adversary.term(torch.full((1, 3, 64, 64), 0.8), generator()) < 0.2


def test_a_render_that_is_not_finite_teaches_nothing(adversary: Adversary) -> None:
    before = [p.detach().clone() for p in adversary.discriminator.parameters()]
    adversary.learn(torch.full((1, 3, 40, 60), torch.nan), torch.rand(1, 3, 40, 60), generator())
    for parameter, old in zip(adversary.discriminator.parameters(), before, strict=True):
        assert torch.equal(parameter, old)
    adversary.learn(torch.rand(1, 3, 40, 60), torch.rand(1, 3, 40, 60), generator())
    assert any(
        not torch.equal(p, old) for p, old in zip(adversary.discriminator.parameters(), before, strict=True)
    )


def test_state_continues_to_the_bit(adversary: Adversary, tmp_path: Path) -> None:
    def step(a: Adversary, seed: int) -> float:
        torch.manual_seed(seed)
        return a.learn(torch.rand(1, 3, 32, 32), torch.rand(1, 3, 32, 32), generator(seed)).item()

    step(adversary, 1)
    torch.save(adversary.state_dict(), tmp_path / "state.pt")
    other = Adversary(256, "cpu")
    other.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    assert step(adversary, 2) == step(other, 2)
    assert step(adversary, 3) == step(other, 3)
