"""Going on under other circumstances: another device, another number of processes, a run that is done."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch
import yaml
from click.testing import CliRunner

from nmbg.cli import main
from nmbg.scene import Scene
from nmbg.training.budget import Clock
from nmbg.training.checkpoint import CONFIG, Progress
from nmbg.training.config import PRESETS
from nmbg.training.loop import Crew, Loop
from nmbg.training.trainer import train


def nmbg(*words: object) -> Any:
    return CliRunner().invoke(main, ["train", *map(str, words)])


@pytest.fixture
def photos(scene_folder: Path, tmp_path: Path) -> Path:
    return train(Scene.load(scene_folder), PRESETS["photos"], tmp_path / "photos")


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is here")
def test_a_run_of_another_device_says_how_to_go_on(photos: Path) -> None:
    path = photos / CONFIG
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), "device": "cuda"}))
    refused = nmbg("--resume", "--output", photos)
    assert refused.exit_code == 2
    assert "add --device cpu" in refused.stderr
    # Without stages there is nothing left to train: it is done.
    assert nmbg("--resume", "--output", photos, "--device", "cpu").exit_code == 0


def test_a_resumed_run_takes_no_scenes(photos: Path, scene_folder: Path) -> None:
    refused = nmbg(scene_folder, "--resume", "--output", photos)
    assert refused.exit_code == 2
    assert "name only its --output" in refused.stderr


@pytest.mark.parametrize(("budget", "step"), [({"iterations": 100}, 50), ({"epochs": 10}, 100)])
def test_other_processes_take_steps_as_they_are_and_passes_in_proportion(
    tmp_path: Path, budget: dict[str, int], step: int
) -> None:
    """Two processes of five views each had taken half of their steps; one goes on with all ten."""
    config = replace(PRESETS["npbg"], perceptual="none", **cast(Any, budget))
    crew = cast(Crew, SimpleNamespace(network=None, counts=[10], length=0, several=True))
    state = Progress(step=50, length=5)
    loop = Loop(config, tmp_path, crew, None, None, state, {}, Clock())
    assert loop.step == step
    assert loop.budget.progress(loop.step) == (0.5 if "iterations" in budget else 1.0)


@pytest.mark.parametrize("place", ["{scene}", "{scene}/run", "{scene}/.."])
def test_a_run_never_takes_the_place_of_its_scene(scene_folder: Path, place: str) -> None:
    before = sorted(scene_folder.rglob("*"))
    output = place.format(scene=scene_folder)
    refused = nmbg(scene_folder, "--output", output, "--preset", "photos", "--overwrite")
    assert refused.exit_code == 2
    assert "give the run a place of its own" in refused.stderr
    assert sorted(scene_folder.rglob("*")) == before


@pytest.mark.parametrize("seed", ["-1", "20250101120000"])
def test_seeds_outside_their_range(scene_folder: Path, tmp_path: Path, seed: str) -> None:
    assert nmbg(scene_folder, "--output", tmp_path / "run", "--seed", seed).exit_code == 2
    assert not (tmp_path / "run").exists()
