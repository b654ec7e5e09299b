"""Whether a scene needs a network, and how wide: short races on left-out training views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from nmbg.capacity.choices import Choice
from nmbg.capacity.cost import network_multiply_adds, seconds_per_frame
from nmbg.capacity.judge import Judge, Limit, Score
from nmbg.losses import l1
from nmbg.model.photographs import Gathered
from nmbg.model.renderer import Renderer
from nmbg.progress import console, progress_bar
from nmbg.scene import Scene, View, evenly
from nmbg.training.budget import Budget, Clock
from nmbg.training.config import TrainConfig
from nmbg.training.left_out import LeftOut, can_leave_out
from nmbg.training.precision import bf16_is_faster
from nmbg.training.start import ColourFit
from nmbg.training.views import Views

# Share of the budget that races take, and passes over their views that tell networks apart.
SHARE, PASSES = 0.2, 40
# Training views that they run on, and views that judge them.
RUNNERS, JUDGES = 24, 8
# What none may cost beside the best network, and what a smaller one may.
NONE_LIMIT, SMALL_LIMIT = Limit(0.02, 0.01), Limit(0.05, 0.01)
# Fewer views teach a network over photographs what holds for them alone: with five, four captures of four are
# shown worse with it than without, with eight three, eleven two; ten cost one 1.3 dB (docs/stability.md).
FEWEST_VIEWS = 12
# One hidden layer of so many channels, an eighth and a fifth of the full size's work, races against it.
SMALL = (8, 12)


@dataclass
class Racer:
    """A network in the race.

    Args:
        renderer: that shows it.
        work: multiply-adds of a frame.
        score: after the last round.
    """

    renderer: Renderer
    work: int
    score: Score

    @property
    def network(self) -> nn.Module:
        """What is trained."""
        assert self.renderer.network is not None
        return self.renderer.network

    def show(self, sight: Gathered, view: View) -> Tensor:
        """Render what was gathered of a view."""
        image: Tensor = self.renderer(sight, view.camera)
        return image


def without_network(config: TrainConfig) -> TrainConfig:
    """A configuration without one: nothing is left to train, whatever the budget."""
    model = replace(config.model, widths=())
    return replace(config, model=model, stages=(), minutes=None, iterations=None, epochs=None)


def unless_too_few(config: TrainConfig, views: int) -> TrainConfig:
    """A configuration without its network over photographs, where there are too few views to train it on."""
    if views >= FEWEST_VIEWS or not (config.model.widths and can_leave_out(config)):
        return config
    reason = f"{views} views teach it what holds for them alone: {FEWEST_VIEWS} are the least"
    choice = Choice("network: none", "all of it", "nothing", reason)
    console.print(str(choice), highlight=False)
    return replace(without_network(config), choices=(*config.choices, choice))


def race(
    scene: Scene, config: TrainConfig, renderer: Renderer, fit: ColourFit, fps: float | None
) -> tuple[tuple[int, ...], nn.Module | None, list[Choice]]:
    """Choose the widths of the network by successive halving.

    Args:
        scene: the scene.
        config: gives the widths of the full size, the budget and the rates.
        renderer: with the photographs that are kept and colours, without a network.
        fit: the colours in folds.
        fps: frames a second that are wished for, or None.

    Returns:
        widths, the network as the race left it, and what was chosen.
    """
    judging = evenly(scene.train, min(JUDGES, len(scene.train) // 2))
    if not judging:
        return (
            config.model.widths,
            None,
            [Choice("network: full", "nothing", "nothing", "one view tells nothing")],
        )
    running = evenly([view for view in scene.train if view not in judging], RUNNERS)
    left_out = LeftOut(renderer, fit)
    examples = Views(scene, tuple(running), left_out.see, config.cache_gib)
    sights = {view.name: left_out.see(view.camera, view) for view in judging}
    judge = Judge(scene, judging)

    def shown(render: Callable[[Gathered, View], Tensor]) -> Score:
        return judge.score(lambda view: render(sights[view.name], view))

    none = shown(lambda sight, view: sight.blended())
    racers, frame = [], judging[0].camera
    for widths in candidates(config.model.widths):
        torch.manual_seed(config.seed)
        model = Renderer(replace(config.model, widths=widths), renderer.layers)
        model.photographs, model.bf16 = renderer.photographs, bf16_is_faster(config.device)
        if fps is None or seconds_per_frame(model, frame) <= 1 / fps:
            racers.append(Racer(model, network_multiply_adds(model, frame), none))
    if not racers:
        return (), None, [Choice("network: none", "all of it", "unknown", f"none reaches {fps:g} frames/s")]

    rounds = max(1, (len(racers) - 1).bit_length())
    left = list(racers)
    with progress_bar() as bar:
        for number in bar.track(range(rounds), description="races of networks"):
            for racer in left:
                _run(racer, examples, config, 1 / (rounds * len(left)))
                with torch.no_grad():
                    racer.score = shown(racer.show)
            best, *small = _ranked(left)
            if number + 1 < rounds:
                # One round is too short to be sure that none of the smaller ones is as good.
                left = [best, *(small or _best_smaller(left, best))[:1]]
    chosen = small[0] if small else best
    most = max(racer.work for racer in racers)
    gained = best.score.psnr - none.psnr, best.score.ssim - none.ssim
    told = f"gains {gained[0]:.2f} dB and {gained[1]:.4f} SSIM on {len(judging)} views"
    if none.within(best.score, NONE_LIMIT):
        saved = f"{most / 1e9:.1f} G multiply-adds a frame"
        return (), None, [Choice("network: none", saved, none.cost_beside(best.score), f"the best {told}")]
    widths = chosen.renderer.config.widths
    saved = f"{(most - chosen.work) / 1e9:.1f} of {most / 1e9:.1f} G multiply-adds a frame"
    choice = Choice(f"network: {widths}", saved, chosen.score.cost_beside(best.score), f"the best {told}")
    return widths, chosen.network, [choice]


def _ranked(racers: list[Racer]) -> list[Racer]:
    """The best one, then those of less work that are as good but for the limit, the least work first."""
    best = max(racers, key=lambda racer: racer.score.psnr)
    small = [r for r in racers if r.work < best.work and r.score.within(best.score, SMALL_LIMIT)]
    return [best, *sorted(small, key=lambda racer: racer.work)]


def _best_smaller(racers: list[Racer], best: Racer) -> list[Racer]:
    """Those of less work, the best first."""
    smaller = [racer for racer in racers if racer.work < best.work]
    return sorted(smaller, key=lambda racer: -racer.score.psnr)


def candidates(full: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Widths that race: one hidden layer, no wider than the first of the full size, and the full size."""
    return [*((width,) for width in SMALL if width <= full[0] and (width,) != full), full]


def _run(racer: Racer, examples: Views, config: TrainConfig, share: float) -> None:
    """Train a network for its share of the races, with a decay of its own."""
    rate = config.stages[-1].network_rate
    optimiser = torch.optim.Adam(racer.network.parameters(), lr=rate)
    generator = torch.Generator().manual_seed(config.seed)
    racer.renderer.train()
    budget, step, done = Budget(_part(config, len(examples), share), len(examples), Clock()), 0, 0.0
    while done < 1:
        i = int(torch.randint(len(examples), (), generator=generator))
        example = examples.crop(i, config.window, generator)
        assert example.image is not None
        image = racer.renderer(example.sight, example.camera)[None]
        target, mask = example.image[None] / 255, example.mask
        counted = None if mask is None else mask[None, None].float()
        loss = l1(image, target, counted)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        for group in optimiser.param_groups:
            group["lr"] = rate * (1 - done)
        optimiser.step()
        step += 1
        done = budget.progress(step)
    racer.renderer.eval()


def _part(config: TrainConfig, n_steps: int, share: float) -> TrainConfig:
    """The budget of one racer in one round: a share of the races' time, and no more passes than tell."""
    if config.minutes is not None:
        return replace(config, minutes=SHARE * share * config.minutes, passes=PASSES)
    total = config.iterations if config.epochs is None else config.epochs * n_steps
    return replace(config, iterations=max(1, round(SHARE * share * (total or 0))), epochs=None)
