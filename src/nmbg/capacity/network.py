"""How much of a network a scene needs: none where there are few views, else few channels, and fewer where
these are not missed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import torch

from nmbg.capacity.channels import Narrowing
from nmbg.capacity.choices import Choice, least
from nmbg.capacity.cost import network_multiply_adds, seconds_per_frame
from nmbg.capacity.judge import JUDGES, Judge, Limit, Score
from nmbg.model.fusion import Fusion
from nmbg.model.photographs import Gathered
from nmbg.model.renderer import Renderer, make_network
from nmbg.progress import console
from nmbg.scene import Scene, evenly
from nmbg.training.config import PRESETS, TrainConfig
from nmbg.training.left_out import can_leave_out
from nmbg.training.precision import bf16_is_faster
from nmbg.training.views import Views

# Channels of each hidden layer that are trained at most: more of them show three captures the same
# (docs/capacity.md). Those that may be left of them.
TRAINED, WIDTHS = 8, (4, 6)
# What no network may cost beside the trained one, and what fewer channels may: they show less of what lies
# beyond the photographs than training views tell.
NONE_LIMIT, NARROW_LIMIT = Limit(0.02, 0.01), Limit(0.01, 0.002)
# Fewer views teach a network over photographs what holds for them alone: with five, four captures of four are
# shown worse with it than without, with eight three, eleven two; ten cost one 1.3 dB (docs/stability.md).
FEWEST_VIEWS = 12


def without_network(config: TrainConfig) -> TrainConfig:
    """A configuration without one: nothing is left to train, whatever the budget."""
    model = replace(config.model, widths=())
    return replace(config, model=model, stages=(), minutes=None, iterations=None, epochs=None)


def few_channels(config: TrainConfig) -> TrainConfig:
    """A configuration whose network is trained with `TRAINED` channels a hidden layer at most."""
    widths = tuple(min(width, TRAINED) for width in config.model.widths)
    return replace(config, model=replace(config.model, widths=widths))


def unless_too_few(config: TrainConfig, views: int) -> TrainConfig:
    """A configuration without its network over photographs, where there are too few views to train it on."""
    if views >= FEWEST_VIEWS or not (config.model.widths and can_leave_out(config)):
        return config
    reason = f"{views} views teach it what holds for them alone: {FEWEST_VIEWS} are the least"
    return _chose(without_network(config), Choice("network: none", "all of it", "nothing", reason))


def size_network(scene: Scene, config: TrainConfig, renderer: Renderer, examples: Views) -> TrainConfig:
    """Cut a trained network to what the scene needs.

    Training views judge it, each as the other photographs show it. They have taught it, so that none at all
    is judged too strictly: a network that learned nothing but them would stay.

    Args:
        scene: gives photographs and masks.
        config: how the network was trained, and the frames a second that are wished for.
        renderer: that holds it, and then holds what is left of it.
        examples: the views that it was trained on.

    Returns:
        the configuration with the size that was chosen, and why.
    """
    judging = evenly(range(len(examples)), JUDGES)
    views = [examples.views[i] for i in judging]
    sights = {view.name: examples.frame(i).sight for view, i in zip(views, judging, strict=True)}
    judge, frame, whole = Judge(scene, views), views[0].camera, renderer.network
    assert isinstance(whole, Fusion)
    narrowing = Narrowing(whole, [sight for sight in sights.values() if isinstance(sight, Gathered)])
    sizes = [(), *narrower(config.model.widths), config.model.widths]
    last = len(sizes) - 1

    @cache
    def network(i: int) -> Fusion | None:
        if i == last:
            return whole
        return narrowing.to(sizes[i]) if sizes[i] else None

    def holding(i: int) -> Renderer:
        renderer.network = network(i)
        return renderer.eval()

    @cache
    @torch.no_grad()
    def score(i: int) -> Score:
        return judge.score(lambda view: holding(i)(sights[view.name], view.camera).cpu())

    def enough(i: int) -> bool:
        return i == last or score(i).within(score(last), NARROW_LIMIT if i else NONE_LIMIT)

    def fast(i: int) -> bool:
        return config.fps is None or seconds_per_frame(holding(i), frame) <= 1 / config.fps

    fewest = i = least(enough, last)
    renderer.bf16 = bf16_is_faster(config.device)
    while i > 0 and not fast(i):
        i -= 1
    named = [str(size or "none") for size in sizes]
    if i < fewest:
        why = f"wished for {config.fps:g} frames a second"
    elif i > 0:
        why = f"{named[i - 1]} costs {score(i - 1).cost_beside(score(last))}"
    else:
        why = "mesh and photographs are enough"
    renderer.network = make_network(replace(config.model, widths=PRESETS[config.preset].model.widths))
    most = network_multiply_adds(renderer, frame)
    work = network_multiply_adds(holding(i), frame)
    saved = f"{(most - work) / 1e9:.1f} of {most / 1e9:.1f} G multiply-adds a frame"
    costs = f"{score(i).cost_beside(score(last))} beside the trained {named[last]}"
    choice = Choice(f"network: {named[i]}", saved, costs, why)
    sized = replace(config, model=replace(config.model, widths=sizes[i])) if i else without_network(config)
    return _chose(sized, choice)


def narrower(full: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Widths below the full size, the least first, with as many layers; none wider than it was."""
    cut = (tuple(min(width, wide) for wide in full) for width in WIDTHS)
    return [widths for widths in dict.fromkeys(cut) if widths != full]


def _chose(config: TrainConfig, choice: Choice) -> TrainConfig:
    console.print(str(choice), highlight=False)
    return replace(config, choices=(*config.choices, choice))
