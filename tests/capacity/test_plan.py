"""A scene sized from its training views, trained, exported, and loaded again."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from nmbg.cameras import Camera
from nmbg.capacity.cost import multiply_adds, network_multiply_adds
from nmbg.capacity.export import export_compact
from nmbg.capacity.judge import Limit, Score
from nmbg.capacity.network import (
    FEWEST_VIEWS,
    Racer,
    _best_smaller,
    _part,
    _ranked,
    candidates,
    unless_too_few,
)
from nmbg.capacity.plan import least, plan
from nmbg.capacity.storage import STORAGES, stored_bytes
from nmbg.cli import main
from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training import checkpoint
from nmbg.training.config import PRESETS
from nmbg.training.trainer import resume, train

AUTO = replace(PRESETS["nmbg"], capacity="auto", minutes=None, iterations=10, refine="none")


@pytest.fixture(scope="module")
def run(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(Scene.load(scene_folder), AUTO, tmp_path_factory.mktemp("runs") / "auto")


def test_every_choice_is_written_with_its_reason(run: Path) -> None:
    _, config = checkpoint.load_one(run)
    told = [choice.choice.partition(":")[0] for choice in config.choices]
    parts = ("vertices", "layers", "photographs", "photographs in a pixel", "faces", "samples a pixel")
    for part in (*parts, "harmonics", "network"):
        assert part in told
    assert all(choice.reason and choice.saves and choice.costs for choice in config.choices)


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


def test_an_exported_run_renders_alike_in_fewer_bytes(run: Path, tmp_path: Path) -> None:
    small = export_compact(run, tmp_path / "small")
    whole, compact = checkpoint.load_run(run), checkpoint.load_run(small)
    for view in Scene.load(whole.source).test:
        images = [r.renderer.render(view.camera) for r in (whole, compact)]
        assert (images[0] - images[1]).abs().mean() < 0.01
    assert stored_bytes(small) < stored_bytes(run)
    assert not list(small.rglob("optimisers.pt"))
    assert evaluate(small, ["psnr"]).mean["psnr"] > 10


def test_full_runs_are_exported_with_their_network(scene_folder: Path, tmp_path: Path) -> None:
    full = replace(AUTO, capacity="full", iterations=2)
    run = train(Scene.load(scene_folder), full, tmp_path / "full")
    small = checkpoint.load_run(export_compact(run, tmp_path / "small"))
    whole = checkpoint.load_run(run)
    camera = Scene.load(scene_folder).test[0].camera
    assert (small.renderer.render(camera) - whole.renderer.render(camera)).abs().mean() < 0.01


def test_a_sized_run_is_resumed_with_its_size(run: Path) -> None:
    before = checkpoint.load_one(run)[1]
    resume(run)
    assert checkpoint.load_one(run)[1] == before


def test_wishes_are_met(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    fast = plan(scene, replace(AUTO, fps=1e6))
    assert fast.config.model.widths == ()
    assert fast.config.stages == ()
    tiny = plan(scene, replace(AUTO, megabytes=1e-6))
    assert tiny.storage == STORAGES[0]


def test_frames_are_timed_in_the_precision_in_which_they_will_be_rendered(
    scene_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    timed = []

    def seconds(renderer: Renderer, camera: Camera) -> float:
        timed.append(renderer.bf16)
        return 1.0

    monkeypatch.setattr("nmbg.capacity.network.seconds_per_frame", seconds)
    for faster in (True, False):
        monkeypatch.setattr("nmbg.capacity.network.bf16_is_faster", lambda device, faster=faster: faster)
        plan(Scene.load(scene_folder), replace(AUTO, fps=30, bf16=not faster))
        assert set(timed) == {faster}
        timed.clear()


@pytest.mark.parametrize(("limit", "fewest"), [(Limit(99, 1), 1), (Limit(-99, -1), 5)])
def test_as_few_photographs_are_blended_in_a_pixel_as_the_limit_allows(
    scene_folder: Path, monkeypatch: pytest.MonkeyPatch, limit: Limit, fewest: int
) -> None:
    monkeypatch.setattr("nmbg.capacity.plan.SOURCES_LIMIT", limit)
    config = replace(AUTO, model=replace(AUTO.model, widths=()))
    assert plan(Scene.load(scene_folder), config).config.model.sources == fewest


@pytest.mark.parametrize("preset", ["mesh", "paper", "photos-mesh"])
def test_other_presets_are_refused(scene_folder: Path, preset: str) -> None:
    with pytest.raises(NmbgError, match="capacity auto"):
        plan(Scene.load(scene_folder), replace(PRESETS[preset], capacity="auto"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fps", "30"], "--capacity auto"),
        (["--megabytes", "2"], "--capacity auto"),
        (["--preset", "mesh", "--capacity", "auto"], "nmbg or photos"),
        (["--photos", "all", "--capacity", "auto"], "--photos all keeps all"),
        (["--preset", "photos", "--capacity", "auto", "--fps", "30"], "no network that could be smaller"),
        (["--init", "{run}", "--capacity", "auto"], "gives the network its size"),
    ],
)
def test_wishes_that_make_no_sense_are_refused(
    scene_folder: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    words = [word.format(run=tmp_path) for word in words]
    result = CliRunner().invoke(main, ["train", str(scene_folder), "--output", str(tmp_path / "r"), *words])
    assert result.exit_code == 2
    assert message in result.stderr


def test_export_says_what_it_needs(run: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "small")
    result = CliRunner().invoke(main, ["export", str(run), "--output", out])
    assert result.exit_code == 2
    assert "--compact" in result.stderr
    assert CliRunner().invoke(main, ["export", str(run), "--compact", "--output", out]).exit_code == 0


@given(first=st.integers(0, 13), usual=st.integers(0, 13))
def test_the_search_from_a_usual_size_finds_the_first_that_is_enough(first: int, usual: int) -> None:
    asked = []

    def enough(i: int) -> bool:
        asked.append(i)
        return i >= first

    assert least(enough, usual) == first
    # Sizes far from both were never tried: each would be a look at a dozen views.
    assert min(asked) >= min(first, usual) - 1
    assert max(asked) <= max(first, usual)


def test_candidates_are_smaller_than_the_full_size() -> None:
    for full in (PRESETS["nmbg"].model.widths, (32,), (8,), (4, 4)):
        *small, last = candidates(full)
        assert last == full
        assert all(len(widths) == 1 and widths[0] <= full[0] and widths != full for widths in small)
    assert len(candidates(PRESETS["nmbg"].model.widths)) == 3


def test_the_smallest_network_that_is_as_good_stands_behind_the_best() -> None:
    def racer(work: int, psnr: float, ssim: float = 0.9) -> Racer:
        return Racer(cast("Renderer", None), work, Score(psnr, ssim))

    full, middle, least = racer(8, 30.0), racer(2, 29.96), racer(1, 29.97)
    assert _ranked([least, middle, full]) == [full, least, middle]
    assert _ranked([racer(1, 29.9), full]) == [full]
    assert _ranked([racer(1, 29.97, 0.898), full]) == [full]
    assert _ranked([racer(1, 30.1), full]) == [racer(1, 30.1)]  # a larger one that is worse is nothing


def test_a_smaller_network_runs_on_even_where_the_first_round_is_against_it() -> None:
    def racer(work: int, psnr: float) -> Racer:
        return Racer(cast("Renderer", None), work, Score(psnr, 0.9))

    best, middle, least = racer(8, 30.0), racer(2, 29.5), racer(1, 29.4)
    assert _best_smaller([least, best, middle], best) == [middle, least]
    assert _best_smaller([least, best, middle], least) == []


def test_races_take_their_share_of_any_budget() -> None:
    full = PRESETS["nmbg"]
    part = _part(full, 24, 0.25)
    assert part.minutes == pytest.approx(0.2 * 0.25 * 15)
    assert part.passes == 40
    steps = replace(full, minutes=None, iterations=400)
    assert _part(steps, 24, 0.25).iterations == 20
    assert _part(replace(steps, iterations=1), 24, 0.25).iterations == 1
    epochs = _part(replace(full, minutes=None, epochs=10), 24, 0.5)
    assert (epochs.iterations, epochs.epochs) == (24, None)


def test_multiply_adds_of_a_network_by_hand(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    model = replace(PRESETS["nmbg"].model, widths=(8, 16))
    renderer = Renderer(model, [scene.mesh])
    camera = scene.test[0].camera
    pixels, features = camera.width * camera.height, 28
    assert network_multiply_adds(renderer, camera) == 9 * pixels * (features * 8 + 8 * 16 + 16 * 8)
    assert multiply_adds(renderer, camera) > network_multiply_adds(renderer, camera)
    plain = Renderer(replace(model, widths=()), [scene.mesh])
    assert network_multiply_adds(plain, camera) == 0


def test_multiply_adds_of_a_u_net_by_hand(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    model = replace(PRESETS["npbg"].model, widths=(8, 32))
    renderer = Renderer(model, [scene.mesh])
    camera = renderer.padded(scene.test[0].camera)
    pixels, features = camera.width * camera.height, 8
    fine = 9 * features * 16 + 9 * 32 * 8 + 9 * 16 * 16 + 8 * 3  # start, up, merge, out
    coarse = 9 * 8 * 2 * (32 - features)
    assert network_multiply_adds(renderer, camera) == pixels * fine + pixels // 4 * coarse


def test_one_training_view_tells_nothing_about_the_network(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    kept = [view for view in scene.views if view.split == "test" or view is scene.train[0]]
    planned = plan(replace(scene, views=tuple(kept)), AUTO)
    assert planned.config.model.widths == AUTO.model.widths
    assert planned.network is None
