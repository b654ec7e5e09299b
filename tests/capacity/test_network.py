"""How much of its network a run keeps."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
import torch

from nmbg.cameras import Camera
from nmbg.capacity.judge import JUDGES, Limit
from nmbg.capacity.network import (
    FEWEST_VIEWS,
    TRAINED,
    WIDTHS,
    few_channels,
    narrower,
    size_network,
    unless_too_few,
)
from nmbg.evaluation.evaluate import evaluate
from nmbg.model.fusion import Fusion
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training import checkpoint
from nmbg.training.config import PRESETS, TrainConfig
from nmbg.training.member import Member
from nmbg.training.trainer import resume, train

FULL = replace(PRESETS["nmbg"], minutes=None, iterations=10, refine="none")
AUTO = replace(FULL, capacity="auto")
NEVER, ANYTHING = Limit(-99, -1), Limit(99, 1)


@pytest.fixture(scope="module")
def full(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(Scene.load(scene_folder), FULL, tmp_path_factory.mktemp("runs") / "full")


@pytest.fixture
def member(full: Path) -> Member:
    """A scene with a network that was trained at its full size."""
    found = checkpoint.latest_checkpoint(full)
    assert found is not None
    member = Member.load(full, checkpoint.load_one(full)[1], None, found)
    checkpoint.load_module(found, "network", member.renderer.network)
    return member


def sized(member: Member, **wishes: object) -> TrainConfig:
    config = replace(member.config, capacity="auto", **wishes)  # type: ignore[arg-type]
    return size_network(member.scene, config, member.renderer, member.training)


def limits(monkeypatch: pytest.MonkeyPatch, none: Limit, narrow: Limit) -> None:
    monkeypatch.setattr("nmbg.capacity.network.NONE_LIMIT", none)
    monkeypatch.setattr("nmbg.capacity.network.NARROW_LIMIT", narrow)


def told(config: TrainConfig) -> str:
    (choice,) = (choice for choice in config.choices if choice.part == "network")
    return str(choice)


@pytest.mark.parametrize(
    ("none", "narrow", "widths"),
    [(ANYTHING, ANYTHING, ()), (NEVER, ANYTHING, (4, 4)), (NEVER, NEVER, FULL.model.widths)],
)
def test_the_least_network_within_the_limits_is_kept(
    member: Member, monkeypatch: pytest.MonkeyPatch, none: Limit, narrow: Limit, widths: tuple[int, ...]
) -> None:
    limits(monkeypatch, none, narrow)
    whole, config = member.renderer.network, sized(member)
    assert config.model.widths == widths
    assert bool(config.stages) is bool(widths)
    assert told(config).startswith(f"network: {widths or 'none'}:")
    kept = member.renderer.network
    assert (kept is whole) is (widths == FULL.model.widths)
    if widths:
        assert isinstance(kept, Fusion)
        assert [parameter.shape[0] for parameter in kept.parameters()][:-2:2] == list(widths)


def test_the_table_counts_from_the_size_of_the_preset(
    member: Member, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if a channel of the first layer were a billion multiply-adds, whatever was trained."""

    def count(renderer: Renderer, camera: Camera) -> float:
        assert renderer.network is not None
        return 1e9 * next(renderer.network.parameters()).shape[0]

    limits(monkeypatch, NEVER, ANYTHING)
    monkeypatch.setattr("nmbg.capacity.network.network_multiply_adds", count)
    trained = Fusion(member.config.model.sources, (8, 8))
    member.renderer.network = trained
    member.config = few_channels(member.config)
    assert "saves 28.0 of 32.0 G multiply-adds" in told(sized(member))


def test_the_table_says_what_the_cut_costs(member: Member, monkeypatch: pytest.MonkeyPatch) -> None:
    """By hand: what both networks show of the views that judge, beside the photographs."""
    limits(monkeypatch, NEVER, ANYTHING)
    renderer, training = member.renderer, member.training
    means = []
    for cut in (False, True):
        if cut:
            config = sized(member)
        total = 0.0
        for i in range(len(training)):
            example = training.frame(i)
            with torch.no_grad():
                image = renderer(example.sight, example.camera).clamp(0, 1)
            assert example.image is not None
            total -= 10 * float((image - example.image / 255).square().mean().log10())
        means.append(total / len(training))
    assert len(training) == FEWEST_VIEWS == JUDGES
    assert f"costs {means[0] - means[1]:.3f} dB" in told(config)


def test_what_renders_fast_enough_is_wished_for(member: Member, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only what has at most six channels is said to be fast enough; the precision is that of rendering."""
    limits(monkeypatch, NEVER, NEVER)
    timed, whole = [], member.renderer.network

    def seconds(renderer: Renderer, camera: Camera) -> float:
        timed.append(renderer.bf16)
        assert renderer.network is not None
        return 0.01 if next(renderer.network.parameters()).shape[0] <= 6 else 1.0

    monkeypatch.setattr("nmbg.capacity.network.seconds_per_frame", seconds)
    for faster in (True, False):
        monkeypatch.setattr("nmbg.capacity.network.bf16_is_faster", lambda device, faster=faster: faster)
        member.renderer.network = whole
        config = sized(member, fps=30, bf16=not faster)
        assert config.model.widths == (6, 6)
        assert "30 frames a second" in told(config)
        assert set(timed) == {faster}
        timed.clear()


def test_where_no_network_is_fast_enough_there_is_none(
    member: Member, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits(monkeypatch, NEVER, NEVER)
    config = sized(member, fps=1e6)
    assert config.model.widths == ()
    assert member.renderer.network is None
    assert "1e+06 frames a second" in told(config)


def test_a_run_is_cut_once_be_it_by_the_one_that_resumes_it(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits(monkeypatch, NEVER, ANYTHING)

    def interrupted(*_: object) -> TrainConfig:
        raise KeyboardInterrupt

    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr("nmbg.training.trainer.size_network", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(Scene.load(scene_folder), AUTO, run)
    assert checkpoint.load_run(run).config.model.widths == (TRAINED, TRAINED)
    states = []
    for _ in range(2):
        resume(run)
        loaded = checkpoint.load_run(run)
        assert loaded.config.model.widths == loaded.renderer.config.widths == (4, 4)
        assert "(4, 4)" in told(loaded.config)
        states.append(loaded.renderer.state_dict())
    assert all(torch.equal(states[0][name], tensor) for name, tensor in states[1].items())
    assert evaluate(run, ["psnr"]).mean["psnr"] > 10
    assert not list(tmp_path.glob(".run*"))


def test_a_run_of_full_size_keeps_its_network(full: Path) -> None:
    config = checkpoint.load_run(full).config
    assert config.model.widths == FULL.model.widths
    assert config.choices == ()


def test_narrower_networks_have_as_many_layers() -> None:
    assert narrower((32, 32)) == [(width, width) for width in WIDTHS]
    assert narrower((32, 5)) == [(4, 4), (6, 5)]
    assert narrower((8,)) == [(4,), (6,)]
    assert narrower((4, 4)) == []


def few(scene_folder: Path, folder: Path, count: int) -> Scene:
    shutil.copytree(scene_folder, folder)
    scene = replace(Scene.load(folder), folder=folder)
    replace(scene, views=(*scene.train[:count], *scene.test)).save(folder)
    return Scene.load(folder)


@pytest.mark.parametrize("capacity", ["full", "auto"])
def test_too_few_views_are_shown_without_a_network(
    scene_folder: Path, tmp_path: Path, capacity: Literal["full", "auto"]
) -> None:
    scene = few(scene_folder, tmp_path / "few", FEWEST_VIEWS - 1)
    run = train(scene, replace(AUTO, capacity=capacity), tmp_path / "run")
    assert checkpoint.load_run(run).renderer.network is None
    told = [str(choice) for choice in checkpoint.load_one(run)[1].choices]
    assert [text for text in told if "network: none" in text and f"{FEWEST_VIEWS} are the least" in text]
    assert evaluate(run, ["psnr"]).mean["psnr"] > 10
    resume(run)


def test_a_network_that_was_learned_elsewhere_is_kept_with_few_views(
    scene_folder: Path, tmp_path: Path
) -> None:
    scene, config = Scene.load(scene_folder), replace(AUTO, capacity="full", iterations=1)
    assert len(scene.train) >= FEWEST_VIEWS
    first = train(scene, config, tmp_path / "first")
    second = train(few(scene_folder, tmp_path / "few", 3), config, tmp_path / "second", init=first)
    for run in (first, second):
        assert checkpoint.load_one(run)[1].model.widths == config.model.widths


def test_only_networks_over_photographs_need_so_many_views() -> None:
    for preset in ("mesh", "photos", "paper", "npbg"):
        assert unless_too_few(PRESETS[preset], 1) == PRESETS[preset]
    assert unless_too_few(PRESETS["nmbg"], FEWEST_VIEWS) == PRESETS["nmbg"]


def test_no_layer_is_trained_with_more_channels_than_its_preset_has() -> None:
    config = replace(AUTO, model=replace(AUTO.model, widths=(32, 4)))
    assert few_channels(config).model.widths == (TRAINED, 4)
    assert few_channels(PRESETS["photos"]) == PRESETS["photos"]
