"""A scene sized from its training views, trained, exported, and loaded again."""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from nmbg.capacity.choices import least
from nmbg.capacity.export import export_compact
from nmbg.capacity.judge import Limit
from nmbg.capacity.plan import plan
from nmbg.capacity.storage import STORAGES, stored_bytes
from nmbg.cli import main
from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
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


def test_photographs_take_no_more_than_is_wished_for(scene_folder: Path) -> None:
    assert plan(Scene.load(scene_folder), replace(AUTO, megabytes=1e-6)).storage == STORAGES[0]


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
