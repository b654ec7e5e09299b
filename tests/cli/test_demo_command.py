"""nmbg demo from end to end, on a capture of a few small photographs."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from nmbg.cli import demo, main
from nmbg.demo.capture import CaptureConfig
from nmbg.images import image_size

TINY = partial(CaptureConfig, width=64, height=48, samples=1, true_edge=0.1, mesh_edge=0.15, points=50)


@pytest.fixture
def run_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))  # no pretrained weights
    monkeypatch.setattr(demo, "CaptureConfig", TINY)

    def run(*words: str) -> Result:
        out = str(tmp_path / "out")
        return CliRunner().invoke(main, ["demo", out, "--views", "14", "--minutes", "0.02", *words])

    return run


def test_the_demo_trains_three_presets_and_shows_their_metrics(run_demo, tmp_path: Path) -> None:
    result = run_demo()
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    summary = result.stdout.split("held-out views, mean")[1]
    for preset in ("colours", "mesh", "nmbg"):
        metrics = json.loads((out / preset / "metrics.json").read_text())
        assert set(metrics["views"]) == {"000.png", "008.png"}
        assert f"{metrics['mean']['psnr']:.2f}" in summary
    # Five panels of 64 pixels with their gaps, and at least two rows of 48.
    width, height = image_size(out / "sheet.png")
    assert width >= 5 * 64
    assert height >= 2 * 48
    assert "lpips is left out" in summary
    assert not list(out.glob(".*"))

    refused = run_demo()
    assert refused.exit_code == 2
    assert "--overwrite" in refused.stderr
    assert (out / "sheet.png").exists()


def test_the_commands_that_the_demo_prints_are_those_of_a_user(run_demo, tmp_path: Path) -> None:
    result = run_demo("--overwrite", "--seed", "5")
    assert result.exit_code == 0, result.output
    commands = [line[2:].split() for line in result.stdout.splitlines() if line.startswith("$ nmbg")]
    assert [words[1] for words in commands] == ["preprocess", *["train", "eval"] * 3]
    again = CliRunner().invoke(main, commands[-1][1:])
    assert again.exit_code == 0, again.output
